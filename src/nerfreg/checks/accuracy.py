"""How far values are from exact ones, and gradients from finite differences."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
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
    """Return `prefix` and a line for each named leaf by which the sum has no finite gradient."""
    names, tensors = zip(*leaves, strict=True)
    grads = torch.autograd.grad(value.sum(), tensors, retain_graph=True, allow_unused=True)
    found = [(name, grad) for name, grad in zip(names, grads, strict=True) if grad is not None]
    return [f"{prefix}{line}" for name, grad in found for line in not_finite(name, grad)]


def wrong_gradient(loss: Loss, inputs: Inputs) -> list[str]:
    """Compare derivatives by autograd with central differences, in float64.

    Directions are random: a relative change of all densities, and a change of all colours.

    Args:
        loss: What is differentiated. What it detaches is held constant.
        inputs: Where it is differentiated.

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


def relative_error(values: Any, truth: Any, dtype: str) -> float:
    """Return the largest error of values relative to exact ones.

    Where the exact value is below the smallest normal number of `dtype`, a value must be so too;
    the error counts as 0 then, else as infinite.

    Args:
        values: A tensor, a number or nested lists.
        truth: Exact values in the same structure.
        dtype: "float32" or "float64".

    Returns:
        The error, NaN if any value is.

    Raises:
        ValueError: There are more or fewer values than exact ones.
    """
    numbers, true = list(_flat(values)), list(_flat(truth))
    if len(numbers) != len(true):
        raise ValueError(f"{len(numbers)} values, but {len(true)} exact ones")
    # Rounding the truth to float64 costs 1e-16 of it.
    found, exact_values = torch.tensor([numbers, true], dtype=torch.float64)
    tiny = torch.finfo(getattr(torch, dtype)).tiny
    nothing = torch.where(found.abs() <= tiny, 0.0, torch.inf)
    normal = exact_values.abs() >= tiny
    errors = torch.where(normal, (found - exact_values).abs() / exact_values.abs(), nothing)
    errors = torch.where(found.isnan(), torch.nan, errors)
    return float(errors.max()) if len(errors) else 0.0


def _flat(values: Any) -> Iterator[float]:
    if isinstance(values, Tensor):
        yield from values.detach().double().flatten().tolist()
    elif isinstance(values, list | tuple):
        for value in values:
            yield from _flat(value)
    else:
        yield float(values)


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
