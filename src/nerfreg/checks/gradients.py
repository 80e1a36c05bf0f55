"""Whether gradients are finite, and whether finite differences give the same ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.overrides import TorchFunctionMode

from nerfreg.checks.inputs import Inputs
from nerfreg.numerics import not_finite

DIRECTIONS = 3
STRIDE = 1e-5
RELATIVE, FLOOR, NOISE = 1e-4, 1e-8, 1e-10
"""How far autograd and finite differences may be apart, as a part of the derivative, and of the
value; and at all, since differences of a loss that is zero or stationary are nothing but rounding.
"""

Loss = Callable[[Inputs], tuple[Float[Tensor, ""], list[Tensor]]]
"""A scalar, and the leaves density (R, N) and colours (R, N, 3) that it was computed from."""


def not_finite_gradients(
    prefix: str, value: Float[Tensor, "*any"], leaves: Iterable[tuple[str, Tensor]]
) -> list[str]:
    """Return one line for each leaf by which the sum of `value` has a gradient that is not finite.

    Args:
        prefix: What each line begins with.
        value: A tensor with a graph, which is kept.
        leaves: Tensors, each with the name that its line goes on with.
    """
    names, tensors = zip(*leaves, strict=True)
    grads = torch.autograd.grad(value.sum(), tensors, retain_graph=True, allow_unused=True)
    found = [(name, grad) for name, grad in zip(names, grads, strict=True) if grad is not None]
    return [f"{prefix}{line}" for name, grad in found for line in not_finite(name, grad)]


def wrong_gradient(loss: Loss, inputs: Inputs) -> list[str]:
    """Compare derivatives by autograd with central differences, in float64.

    Args:
        loss: What is differentiated. What it detaches is held constant.
        inputs: Where, along random directions: a relative change of all densities, and one of all
            colours.

    Returns:
        One line about the first direction in which the two disagree, if there is one.
    """
    generator = torch.Generator().manual_seed(1)
    for _ in range(DIRECTIONS):
        logs, colors = (
            torch.randn(x.shape, generator=generator).double()
            for x in (inputs.density, inputs.colors)
        )
        with _Detached([]) as detached:
            value, leaves = loss(inputs)
        grads = torch.autograd.grad(value, leaves, allow_unused=True, materialize_grads=True)
        by_density = (grads[0] * inputs.density * logs).sum()
        by_autograd = (by_density + (grads[1] * colors).sum()).item()
        ends = []
        for stride in (STRIDE, -STRIDE):
            density = inputs.density * torch.exp(stride * logs)
            moved = replace(inputs, density=density, colors=inputs.colors + stride * colors)
            with _Detached(list(detached.made)):
                ends.append(loss(moved)[0].item())
        by_differences = (ends[0] - ends[1]) / (2 * STRIDE)
        size = max(abs(by_autograd), abs(by_differences))
        allowed = RELATIVE * size + FLOOR * abs(value.item()) + NOISE
        if not abs(by_autograd - by_differences) <= allowed:
            both = f"{by_autograd:.6g} by autograd, {by_differences:.6g} by finite differences"
            return [f"derivative is {both}"]
    return []


class _Detached(TorchFunctionMode):
    """Records what `Tensor.detach` returns, or returns what was recorded, in order.

    A loss that detaches a tensor says that it counts as a constant; finite differences must treat
    it so, too.
    """

    def __init__(self, recorded: list[Tensor]) -> None:
        super().__init__()
        self.made: list[Tensor] = []
        self._replay = iter(recorded)
        self._replaying = bool(recorded)

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        if func is torch.Tensor.detach:
            if self._replaying:
                return next(self._replay).clone()
            self.made.append(result.clone())
        return result
