from __future__ import annotations

from math import cos, exp, pi, sin

import mpmath
import pytest
import torch
from mpmath import mp

from nerfreg.bench.media import MEDIA, PHASES, Medium, Wall, color, exact, walls


def by_name(name: str) -> Medium:
    return next(medium for medium in MEDIA if medium.name == name)


def density(medium: Medium, t: object) -> object:
    """The density that is sampled, for mpmath."""
    return mpmath.mpf(medium.density(torch.tensor([float(t)], dtype=torch.float64)).item())


@pytest.mark.parametrize("medium", MEDIA, ids=lambda medium: medium.name)
@pytest.mark.parametrize("end", [0.25, 0.6005, 1.0])
def test_thickness_is_the_integral_of_density(medium: Medium, end: float) -> None:
    pieces = [0, *(t for t in medium.breaks if t < end), end]
    with mp.workdps(15):
        expected = mpmath.quad(lambda t: density(medium, t), pieces)
        # The wall's own edges take part in the rounding of the quadrature's nodes.
        assert float(medium.thickness(mp.mpf(end))) == pytest.approx(
            float(expected), rel=1e-8, abs=1e-12
        )


@pytest.mark.parametrize("medium", MEDIA, ids=lambda medium: medium.name)
def test_exact_is_the_rendering_integral(medium: Medium) -> None:
    # As it is defined, of exp(-thickness) density f, which neither the closed forms nor the parts
    # use.
    def integral(f):
        with mp.workdps(15):
            pieces = [0, *medium.breaks, 1]
            return float(
                mpmath.quad(
                    lambda t: f(t) * density(medium, t) * mpmath.exp(-medium.thickness(t)), pieces
                )
            )

    opacity, depth, rgb = exact(medium)
    assert integral(lambda t: 1) == pytest.approx(opacity, rel=1e-6)
    assert integral(lambda t: t) / opacity == pytest.approx(depth, rel=1e-6)
    red = integral(lambda t: (1 + mpmath.cos(2 * mpmath.pi * t)) / 2)
    assert red == pytest.approx(rgb[0], rel=1e-6)


def test_slab_by_hand() -> None:
    # s exp(-s t) on [0, 1], s = 3. Opacity 1 - exp(-3). The first moment is (1 - (1 + s) exp(-s)) /
    # s; that of cos(w t + a), w = 2 pi, is (1 - exp(-s)) s (s cos a - w sin a) / (s^2 + w^2), since
    # t = 1 is a whole wave.
    opacity, depth, rgb = exact(by_name("slab"))
    hit = 1 - exp(-3)
    assert opacity == pytest.approx(hit, rel=1e-14)
    assert depth == pytest.approx((1 - 4 * exp(-3)) / 3 / hit, rel=1e-14)
    for channel, phase in zip(rgb, PHASES, strict=True):
        a, w = 2 * pi * phase, 2 * pi
        wave = hit * 3 * (3 * cos(a) - w * sin(a)) / (9 + w**2)
        assert channel == pytest.approx((hit + wave) / 2, rel=1e-14)


def test_an_opaque_wall_shows_its_front() -> None:
    # Light goes 1e-9 deep.
    wall = walls("wall", Wall(0.25, 0.5, 1e9))
    opacity, depth, rgb = exact(wall)
    assert opacity == 1
    assert depth == pytest.approx(0.25, abs=2e-9)
    front = color(torch.tensor([[0.25]], dtype=torch.float64))[0, 0]
    torch.testing.assert_close(torch.tensor(rgb, dtype=torch.float64), front, rtol=0, atol=1e-8)


def test_a_wall_behind_one_that_lets_half_through() -> None:
    # Both walls are thin, so that all happens at their places: half at 0.3, half at 0.7.
    opacity, depth, _ = exact(by_name("two_shells"))
    assert opacity == pytest.approx(1)
    assert depth == pytest.approx(0.5, abs=1e-3)


def test_stiff_media_stay_within_the_ray_when_it_is_drawn_back() -> None:
    for medium in MEDIA:
        if medium.slack:
            gone = torch.tensor([1 - medium.slack, 1.0], dtype=torch.float64)
            assert not medium.density(gone).any(), medium.name
            assert not medium.density(-gone).any(), medium.name
