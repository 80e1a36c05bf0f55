"""`nerfreg bench quadrature`: how well a ray is rendered, against the time it takes.

Densities with known opacity, depth and colour are sampled as nerfreg's renderers sample them, and composited.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.analysis.tables import Outcome, write_points
from nerfreg.bench.media import MEDIA, Medium, color, exact
from nerfreg.bench.samplers import SAMPLERS, Bundle, Sampled
from nerfreg.bench.timing import median_seconds
from nerfreg.rendering.compositing import composite

GOLDEN_RATIO = (1 + 5**0.5) / 2
QUANTITIES = ("opacity", "depth", "color")


@dataclass(frozen=True)
class Sizes:
    """samples: per ray, ascending. rays: at once. repetitions: of each measurement of time."""

    samples: tuple[int, ...]
    rays: int
    repetitions: int


FULL = Sizes(tuple(2**k for k in range(3, 13)), rays=256, repetitions=7)
QUICK = Sizes((8, 64, 512), rays=16, repetitions=1)


@dataclass(frozen=True)
class Point:
    """One medium sampled in one way. Errors are means over rays, with their 10 and 90 % quantiles.

    samples, evaluations: per ray, the latter of the density. microseconds: per ray, for sampling, density, colour and
    compositing. The errors of opacity and colour are relative to the exact value, that of depth to the ray's length.
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

    def error(self, quantity: str) -> float:
        """The mean error of "opacity", "depth" or "color"."""
        value: float = getattr(self, f"{quantity}_error")
        return value


def run(folder: Path, sizes: Sizes) -> Outcome:
    """Measure all media, samplers, sizes and precisions; print a table; write a CSV file and a plot."""
    from nerfreg.bench.quadrature_report import draw, print_table

    dtypes = (torch.float32, torch.float64)
    points = [
        point for medium in MEDIA for dtype in dtypes for point in measure(medium, dtype, sizes)
    ]
    print_table(points, sizes)
    return Outcome(
        [
            write_points(folder / "quadrature.csv", points),
            *draw(points, sizes, folder / "quadrature"),
        ]
    )


def measure(medium: Medium, dtype: torch.dtype, sizes: Sizes) -> list[Point]:
    """One point for each sampler and number of samples."""
    # Multiples of the golden ratio are spread evenly over the slack, and over each of any number of equal parts of it.
    shift = medium.slack * (torch.arange(sizes.rays, dtype=dtype) * GOLDEN_RATIO % 1)
    rays = Bundle(medium, -shift, 1 - shift, torch.Generator().manual_seed(0))
    name = str(dtype).removeprefix("torch.")
    points = []
    for count in sizes.samples:
        seconds = median_seconds(
            [partial(render, rays, sampler, count) for sampler in SAMPLERS], sizes.repetitions
        )
        for sampler, time in zip(SAMPLERS, seconds, strict=True):
            sampled, *values = render(rays, sampler, count)
            spread = [
                number
                for error in _errors(medium, *values)
                for number in _mean_and_quantiles(error)
            ]
            microseconds = time / sizes.rays * 1e6
            points.append(
                Point(medium.name, sampler, name, count, sampled.evaluations, microseconds, *spread)
            )
    return points


def render(
    rays: Bundle, sampler: str, count: int
) -> tuple[Sampled, Float[Tensor, " rays"], Float[Tensor, " rays"], Float[Tensor, "rays 3"]]:
    """The samples of each ray, and the opacity, depth and colour that are composited from them."""
    sampled = SAMPLERS[sampler](rays, count)
    result = composite(sampled.density, color(sampled.t), sampled.t_edges)
    assert result.rgb is not None
    return sampled, result.opacity, result.depth, result.rgb


def fitted_order(
    points: Iterable[Point], quantity: str, fewest: int = 64, floor: float = 1e-12
) -> float | None:
    """p in error ~ samples^-p, by least squares over the points with enough samples and an error above rounding.

    None where fewer than 3 points are left.
    """
    fitted = [
        (p.samples, p.error(quantity))
        for p in points
        if p.samples >= fewest and p.error(quantity) > floor
    ]
    if len(fitted) < 3:
        return None
    samples, errors = np.log(np.array(fitted)).T
    return float(-np.polyfit(samples, errors, 1)[0])


def first_below(points: Sequence[Point], quantity: str, error: float) -> Point | None:
    """The point of fewest samples from which on the error stays below a bound."""
    good = None
    for point in sorted(points, key=lambda point: -point.samples):
        if point.error(quantity) >= error:
            break
        good = point
    return good


def _errors(
    medium: Medium,
    opacity: Float[Tensor, " rays"],
    depth: Float[Tensor, " rays"],
    rgb: Float[Tensor, "rays 3"],
) -> tuple[Float[Tensor, " rays"], Float[Tensor, " rays"], Float[Tensor, " rays"]]:
    truth = exact(medium)
    true_color = torch.tensor(truth.color, dtype=torch.float64)
    return (
        (opacity.double() - truth.opacity).abs() / truth.opacity,
        (depth.double() - truth.depth).abs(),
        (rgb.double() - true_color).norm(dim=1) / true_color.norm(),
    )


def _mean_and_quantiles(error: Float[Tensor, " rays"]) -> list[float]:
    low, high = error.quantile(error.new_tensor([0.1, 0.9])).tolist()
    return [error.mean().item(), low, high]
