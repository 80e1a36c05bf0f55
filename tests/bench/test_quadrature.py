from __future__ import annotations

from dataclasses import fields

import pytest
import torch

from nerfreg.bench.media import MEDIA, exact
from nerfreg.bench.quadrature import RayErrors, first_below, fitted_order, measure, render
from nerfreg.bench.samplers import Bundle
from nerfreg.bench.timing import RaySizes

SIZES = RaySizes((64, 128, 256, 512), rays=16, repetitions=1)


def points(name: str, sizes: RaySizes = SIZES, sampler: str = "uniform") -> list[RayErrors]:
    medium = next(medium for medium in MEDIA if medium.name == name)
    return [point for point in measure(medium, torch.float64, sizes) if point.sampler == sampler]


def point(samples: int, error: float) -> RayErrors:
    values = {field.name: error for field in fields(RayErrors)}
    return RayErrors(**values | {"medium": "", "sampler": "", "dtype": "", "samples": samples})


@pytest.mark.parametrize("name", ["exponential", "gaussian_bump"])
@pytest.mark.parametrize("quantity", ["opacity", "depth", "color"])
def test_midpoints_converge_with_order_2_on_smooth_media(name: str, quantity: str) -> None:
    assert fitted_order(points(name), f"{quantity}_error") == pytest.approx(2, abs=0.02)


def test_slab() -> None:
    # Density is constant in every interval of length h: opacity is exact. Depth takes the middle of
    # each interval for the mean of s exp(-s t) inside it, which lies s h^2 / 12 before the middle,
    # to second order; s = 3.
    for measured in points("slab"):
        assert measured.opacity_error < 1e-14
        assert measured.depth_error == pytest.approx(3 / 12 / measured.samples**2, rel=1e-3)


@pytest.mark.parametrize("quantity", ["opacity", "depth", "color"])
def test_samples_by_length_converge_with_order_2_across_gaps(quantity: str) -> None:
    # Across borders of windows, samples of the whole ray converge with order 1 alone.
    sizes = RaySizes(tuple(2**k for k in range(6, 12)), rays=16, repetitions=1)
    error = f"{quantity}_error"
    by_length = points("exponential_with_gaps", sizes, "inside")
    assert fitted_order(by_length, error) == pytest.approx(2, abs=0.1)
    even = points("exponential_with_gaps", sizes, "uniform")
    assert fitted_order(even, error) < 1.5
    for ours, theirs in zip(by_length, even, strict=True):
        assert getattr(ours, error) < getattr(theirs, error) / 5


def test_slabs_with_gaps_between_them_are_exactly_as_opaque() -> None:
    for measured in points("slab_with_gaps", sampler="inside"):
        assert measured.opacity_error < 1e-14
        assert measured.depth_error < 1e-4


def test_a_medium_without_gaps_is_not_sampled_twice() -> None:
    assert points("slab", sampler="inside") == []


def test_a_shell_between_two_samples_is_not_there() -> None:
    # Half of the rays, evenly spread over an interval of 1/384, have a sample in the shell of
    # 1/768.
    sizes = RaySizes((384,), rays=384, repetitions=1)
    (measured,) = points("shell_1e6", sizes)
    assert measured.opacity_error == pytest.approx(1 / 2, abs=0.03)


def test_a_thin_shell_that_is_hit_counts_whole_intervals() -> None:
    # Optical thickness is that of n whole intervals, n / 1024 instead of 1 / 768: 3/4 n of the
    # truth. One hit on two thirds of the rays, two on one third: mean error 2/3 * 1/4 + 1/3 * 1/2 =
    # 1/3. A quarter as much for 4096: 5 hits on two thirds, 6 on one.
    sizes = RaySizes((1024, 4096), rays=400, repetitions=1)
    coarse, fine = points("shell_1e0", sizes)
    assert coarse.opacity_error == pytest.approx(1 / 3, rel=0.02)
    assert fine.opacity_error == pytest.approx(1 / 12, rel=0.05)


def test_errors_are_those_of_the_rendering() -> None:
    medium = next(medium for medium in MEDIA if medium.name == "exponential")
    rays = Bundle(medium, torch.zeros(1), torch.ones(1), torch.Generator())
    _, opacity, depth, rgb = render(rays, "uniform", 16)
    truth = exact(medium)
    (measured,) = [
        p for p in measure(medium, torch.float32, RaySizes((16,), 4, 1)) if p.sampler == "uniform"
    ]
    assert measured.opacity_error == pytest.approx(
        abs(opacity.item() - truth.opacity) / truth.opacity, rel=1e-3
    )
    assert measured.depth_error == pytest.approx(abs(depth.item() - truth.depth), rel=1e-3)
    off = (rgb[0].double() - torch.tensor(truth.color, dtype=torch.float64)).norm().item()
    assert measured.color_error == pytest.approx(
        off / sum(c**2 for c in truth.color) ** 0.5, rel=1e-3
    )
    assert measured.color_error_p10 == pytest.approx(measured.color_error_p90, rel=1e-5)
    assert (measured.samples, measured.evaluations) == (16, 16)


def test_the_default_type_is_left_as_it_was() -> None:
    points("slab", RaySizes((8,), rays=4, repetitions=1))
    assert torch.get_default_dtype() == torch.float32


def test_fitted_order_of_powers() -> None:
    # Fewer than 64 samples and errors of rounding do not count.
    exactly = [point(n, 5.0 * n**-1.5) for n in (64, 128, 256)]
    assert fitted_order(
        [point(8, 1.0), *exactly, point(512, 1e-14)], "depth_error"
    ) == pytest.approx(1.5)
    assert fitted_order(exactly[:2], "depth_error") is None


def test_first_below_wants_all_that_follow_below() -> None:
    lucky = [point(8, 1e-3), point(16, 0.5), point(32, 5e-3), point(64, 1e-4)]
    assert first_below(lucky, 0.01) == lucky[2]
    assert first_below(lucky, 1e-5) is None
