"""The rendering integral in many digits, and how far other numbers are from exact ones."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import mpmath
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.numerics import MIN_OPACITY, exact
from nerfreg.registry import REFERENCE_DIGITS

TINY = {"float32": torch.finfo(torch.float32).tiny, "float64": torch.finfo(torch.float64).tiny}


class ExactRay(NamedTuple):
    """One ray: N numbers for weights and log_transmittance, three for rgb."""

    weights: list[Any]
    log_transmittance: list[Any]
    opacity: Any
    depth: Any
    rgb: list[Any]


def composite_exactly(
    sigma: Float[Tensor, "rays samples"],
    rgb: Float[Tensor, "rays samples 3"],
    t_edges: Float[Tensor, "rays edges"],
    background: Float[Tensor, "rays 3"] | None = None,
) -> list[ExactRay]:
    """What `nerfreg.rendering.compositing.composite` computes, ray by ray, from tensors that count as exact."""
    with mpmath.workdps(REFERENCE_DIGITS):
        backgrounds = [[0, 0, 0]] * len(sigma) if background is None else exact(background)
        rays = zip(exact(sigma), exact(rgb), exact(t_edges), backgrounds, strict=True)
        return [_ray(*ray) for ray in rays]


def _ray(sigma: list[Any], rgb: list[Any], edges: list[Any], background: list[Any]) -> ExactRay:
    passed, light = mpmath.mpf(0), mpmath.mpf(1)
    weights, logs, moment = [], [], mpmath.mpf(0)
    color = [mpmath.mpf(0)] * 3
    for density, hue, low, high in zip(sigma, rgb, edges, edges[1:], strict=False):
        logs.append(-passed)
        tau = density * (high - low)
        # Products, not differences: exp(-1e-12) is close to 1, and what is left of 1 is the weight.
        weight = light * -mpmath.expm1(-tau) if tau else mpmath.mpf(0)
        if tau:
            passed += tau
            light = mpmath.exp(-passed)
            color = [c + weight * h for c, h in zip(color, hue, strict=True)]
            moment += weight * (low + high) / 2
        weights.append(weight)
    opacity = -mpmath.expm1(-passed)
    # opacity is the sum of the weights
    depth = moment / opacity if opacity >= MIN_OPACITY else edges[-1]
    return ExactRay(
        weights,
        logs,
        opacity,
        depth,
        [c + light * b for c, b in zip(color, background, strict=True)],
    )


def relative_error(values: Any, truth: Any, dtype: str) -> float:
    """The largest error of `values` (a tensor, a number or nested lists) relative to `truth`, of the same structure.

    Where the truth is below the smallest normal number of `dtype` a value must be so too; the error counts as 0 then,
    else as infinite. NaN if any value is. Raises ValueError where there are more or fewer values than true ones.
    """
    numbers, true = list(_flat(values)), list(_flat(truth))
    if len(numbers) != len(true):
        raise ValueError(f"{len(numbers)} values, but {len(true)} exact ones")
    # Rounding the truth to float64 costs 1e-16 of it.
    found, exact_values = torch.tensor([numbers, true], dtype=torch.float64)
    tiny = TINY[dtype]
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
