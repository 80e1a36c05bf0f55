"""Derivatives by finite differences, with what a loss holds constant held constant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.overrides import TorchFunctionMode

from nerfreg.checks.inputs import Inputs

DIRECTIONS = 3
STRIDE = 1e-5
RELATIVE, FLOOR, NOISE = 1e-4, 1e-8, 1e-10
"""How far autograd and finite differences may be apart, as a part of the derivative, and of the value; and at all,
for a loss that is zero or stationary has differences that are nothing but rounding."""

Loss = Callable[[Inputs], tuple[Float[Tensor, ""], list[Tensor]]]
"""A scalar, and the leaves density (R, N) and colours (R, N, 3) that it was computed from."""


class Direction(NamedTuple):
    """A change of all densities, relative to each, and of all colours."""

    log_density: Float[Tensor, "rays samples"]
    colors: Float[Tensor, "rays samples 3"]


def wrong_gradient(loss: Loss, inputs: Inputs) -> list[str]:
    """Compare the derivative along random directions that autograd gives with central differences, in float64."""
    chance = torch.Generator().manual_seed(1)
    lines = []
    for _ in range(DIRECTIONS):
        direction = Direction(
            *(
                torch.randn(x.shape, generator=chance).double()
                for x in (inputs.density, inputs.colors)
            )
        )
        with _Detached([]) as detached:
            value, (density, colors) = loss(inputs)
        grads = torch.autograd.grad(
            value, [density, colors], allow_unused=True, materialize_grads=True
        )
        by_density = (grads[0] * inputs.density * direction.log_density).sum()
        by_autograd = (by_density + (grads[1] * direction.colors).sum()).item()
        ends = []
        for stride in (STRIDE, -STRIDE):
            with _Detached(list(detached.made)):
                ends.append(loss(_moved(inputs, direction, stride))[0].item())
        by_differences = (ends[0] - ends[1]) / (2 * STRIDE)
        size = max(abs(by_autograd), abs(by_differences))
        if (
            not abs(by_autograd - by_differences)
            <= RELATIVE * size + FLOOR * abs(value.item()) + NOISE
        ):
            lines.append(
                f"derivative is {by_autograd:.6g} by autograd, {by_differences:.6g} by finite differences"
            )
    return lines[:1]


def _moved(inputs: Inputs, direction: Direction, stride: float) -> Inputs:
    density = inputs.density * torch.exp(stride * direction.log_density)
    return replace(inputs, density=density, colors=inputs.colors + stride * direction.colors)


class _Detached(TorchFunctionMode):
    """Records what `Tensor.detach` returns, or returns what was recorded, in order.

    A loss that detaches a tensor says that it is to count as a constant. Finite differences must do the same.
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
