"""`nerfreg bench quadrature`: how well a ray is rendered, against the time it takes.

Densities with known opacity, depth and colour are sampled as nerfreg's renderers sample them, and
composited.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product, takewhile
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from rich.table import Table
from torch import Tensor

from nerfreg.analysis.curves import Dot, draw_curves
from nerfreg.analysis.tables import build_table, numbers, publish_points, select, text
from nerfreg.bench import BenchOutcome
from nerfreg.bench.media import MEDIA, Medium, color, exact
from nerfreg.bench.samplers import SAMPLERS, Bundle, Sampled, samplers_of
from nerfreg.bench.timing import RaySizes, median_seconds
from nerfreg.rendering.compositing import composite

GOLDEN_RATIO = (1 + 5**0.5) / 2
ERRORS = ("opacity_error", "depth_error", "color_error")
UNPLOTTED = ("slab", "shell_1e2", "shell_1e4")
GOAL = 0.01
"""The colour error for which the table gives the number of samples and the time."""
FEWEST, RESOLVED = 64, 1024
"""Samples from which on the order is fitted; in stiff media every ray must have one in a shell."""
LOWEST = 1e-8
"""Errors below are drawn there."""

FULL = RaySizes(tuple(2**k for k in range(3, 13)), rays=256, repetitions=7)
QUICK = RaySizes((8, 64, 512), rays=16, repetitions=1)


@dataclass(frozen=True)
class RayErrors:
    """One medium sampled in one way.

    The errors of opacity and colour are relative to the exact value, that of depth to the length
    of the ray; they are means over rays, with their 10 and 90 % quantiles. Evaluations, of the
    density, and microseconds, for sampling, density, colour and compositing, are per ray.
    """

    medium: str
    sampler: str
    dtype: str
    samples: int
    evaluations: float
    microseconds: float
    opacity_error: float
    opacity_error_p10: float
    opacity_error_p90: float
    depth_error: float
    depth_error_p10: float
    depth_error_p90: float
    color_error: float
    color_error_p10: float
    color_error_p90: float


def run(folder: Path, sizes: RaySizes) -> BenchOutcome:
    """Measure all media, samplers, numbers of samples and precisions, and publish them."""
    points = [
        point
        for medium, dtype in product(MEDIA, (torch.float32, torch.float64))
        for point in measure(medium, dtype, sizes)
    ]
    return BenchOutcome(
        publish_points(folder / "quadrature", points, tabulate(points, sizes), draw)
    )


def measure(medium: Medium, dtype: torch.dtype, sizes: RaySizes) -> list[RayErrors]:
    """Return one point for each sampler and number of samples."""
    # Multiples of the golden ratio are spread evenly over the slack, and over each of any number of
    # equal parts of it.
    shift = medium.slack * (torch.arange(sizes.rays, dtype=dtype) * GOLDEN_RATIO % 1)
    rays = Bundle(medium, -shift, 1 - shift, torch.Generator().manual_seed(0))
    name = str(dtype).removeprefix("torch.")
    points = []
    for count in sizes.samples:
        samplers = samplers_of(medium)
        calls = [partial(render, rays, sampler, count) for sampler in samplers]
        seconds = median_seconds(calls, sizes.repetitions)
        for sampler, call, time in zip(samplers, calls, seconds, strict=True):
            sampled, *values = call()
            cost, errors = (sampled.evaluations, time / sizes.rays * 1e6), _errors(medium, *values)
            points.append(RayErrors(medium.name, sampler, name, count, *cost, *errors))
    return points


def render(
    rays: Bundle, sampler: str, count: int
) -> tuple[Sampled, Float[Tensor, " rays"], Float[Tensor, " rays"], Float[Tensor, "rays 3"]]:
    """Return the samples of each ray, and the opacity, depth and colour composited from them."""
    sampled = SAMPLERS[sampler](rays, count)
    result = composite(sampled.density, color(sampled.t), sampled.t_edges)
    assert result.rgb is not None
    return sampled, result.opacity, result.depth, result.rgb


def fitted_order(
    points: Iterable[RayErrors], error: str, fewest: int = FEWEST, floor: float = 1e-12
) -> float | None:
    """Return p in error ~ samples^-p, by least squares of logarithms.

    Points with fewer samples than `fewest`, and those whose error is rounding (at most `floor`),
    do not count. None where fewer than 3 points are left.
    """
    errors = [(p.samples, getattr(p, error)) for p in points if p.samples >= fewest]
    fitted = [(samples, value) for samples, value in errors if value > floor]
    x, y = np.log(np.array(fitted).reshape(-1, 2)).T
    return None if len(fitted) < 3 else float(-np.polyfit(x, y, 1)[0])


def first_below(points: Sequence[RayErrors], bound: float) -> RayErrors | None:
    """Return the point of fewest samples from which on the error of colour stays below a bound."""
    ordered = sorted(points, key=lambda point: -point.samples)
    good = list(takewhile(lambda point: point.color_error < bound, ordered))
    return good[-1] if good else None


def tabulate(points: Sequence[RayErrors], sizes: RaySizes) -> Table:
    """Return the orders of convergence in float64 and the work for a small error in float32."""
    headers = [name.replace("_", "\n") for name in SAMPLERS]
    return build_table(
        "Rendering one ray: orders of convergence; samples (µs) for 1 % colour error",
        f"Orders: uniform midpoints in float64, {sizes.samples[-1]} samples down to {FEWEST} "
        f"(stiff: {RESOLVED}). Samples: per ray in float32, from which on the error stays below. "
        f"Times: {sizes.rays} rays at once; {sizes.conditions}.",
        [*text("medium"), *numbers("opacity", "depth", "color", *headers)],
        [_row(medium, select(points, medium=medium.name)) for medium in MEDIA],
    )


def draw(points: Sequence[RayErrors], stem: Path) -> list[Path]:
    """Draw errors in float32 against run time, and that of colour against evaluations as well."""
    shown = [p for p in select(points, dtype="float32") if p.medium not in UNPLOTTED]
    dots = [
        Dot(error.replace("_", " "), p.medium, p.sampler, p.microseconds, getattr(p, error))
        for error, p in product(ERRORS, shown)
    ]
    against = "color error against evaluations"
    dots += [Dot(against, p.medium, p.sampler, p.evaluations, p.color_error) for p in shown]
    title = "Rendering one ray in float32: error against time, and (lowest row) against evaluations"
    xlabel = "time (µs) or evaluations per ray"
    return draw_curves(stem, dots, title, (13.5, 10.2), xlabel, (LOWEST, math.inf))


def _errors(medium: Medium, opacity: Tensor, depth: Tensor, rgb: Tensor) -> list[float]:
    truth = exact(medium)
    true_color = torch.tensor(truth.color, dtype=torch.float64)
    opacity_error = (opacity.double() - truth.opacity).abs() / truth.opacity
    depth_error = (depth.double() - truth.depth).abs()
    color_error = (rgb.double() - true_color).norm(dim=1) / true_color.norm()
    numbers = []
    for error in (opacity_error, depth_error, color_error):
        quantiles = error.quantile(error.new_tensor([0.1, 0.9]))
        numbers += [error.mean().item(), *quantiles.tolist()]
    return numbers


def _row(medium: Medium, points: Sequence[RayErrors]) -> list[str]:
    fewest, row = RESOLVED if medium.slack else FEWEST, [medium.name]
    for error in ERRORS:
        own = select(points, sampler="uniform", dtype="float64")
        order = fitted_order(own, error, fewest)
        row.append("-" if order is None else f"{order:.2f}")
    for sampler in SAMPLERS:
        if sampler not in samplers_of(medium):
            row.append("-")
            continue
        point = first_below(select(points, sampler=sampler, dtype="float32"), GOAL)
        digits = 0 if point and point.microseconds >= 10 else 1
        row.append(f"{point.samples} ({point.microseconds:.{digits}f})" if point else "never")
    return row
