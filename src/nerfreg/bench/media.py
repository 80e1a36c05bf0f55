"""Densities along a ray [0, 1] whose optical thickness has a closed form, and what the ray shows.

The exact opacity, depth and colour are integrals of exp(-thickness(t)) density(t) f(t), by
quadrature with 30 digits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from mpmath import mp
from torch import Tensor

DIGITS = 30
PHASES = (0.0, 1 / 3, 2 / 3)
"""Of red, green and blue: (1 + cos(2 pi (t + phase))) / 2."""


def color(t: Float[Tensor, "*points"]) -> Float[Tensor, "*points 3"]:
    """Return the colour at distances t: smooth, and the same in all media."""
    return (1 + torch.cos(2 * math.pi * (t[..., None] + t.new_tensor(PHASES)))) / 2


# Compared by identity, so that `exact` can be cached.
@dataclass(frozen=True, eq=False)
class Medium:
    """A density along a ray.

    Attributes:
        name: In files and figures.
        density: At distances t, of any shape.
        thickness: Optical thickness from 0 to t, an mpmath number, in closed form.
        breaks: Ascending distances in (0, 1) between which the density is smooth and not steep.
        slack: How far both ends of the ray may be moved towards the camera, with nothing but
            vacuum gained or lost; above 0 for stiff media, which are thin beside the ray.
        windows: Ascending (begin, end) outside of which space is declared empty; none: nothing is.
    """

    name: str
    density: Callable[[Tensor], Tensor]
    thickness: Callable[[Any], Any]
    breaks: tuple[float, ...] = ()
    slack: float = 0.0
    windows: tuple[tuple[float, float], ...] = ()


class Exact(NamedTuple):
    """What a ray shows: opacity, expected distance, and colour without background."""

    opacity: float
    depth: float
    color: tuple[float, float, float]


@cache
def exact(medium: Medium) -> Exact:
    """Return what a ray through the medium shows.

    Integrals of exp(-thickness) density f are taken by parts, so that only the thickness is needed,
    with f = 1, t and exp(2 pi i t), the last of which holds the colours of all phases.
    """

    def transmitted(t: Any) -> Any:
        return mp.exp(-medium.thickness(t))

    with mp.workdps(DIGITS):
        pieces = [mp.zero, *map(mp.mpf, medium.breaks), mp.one]
        passed, wave_number = transmitted(mp.one), 2j * mp.pi
        mass = -mp.expm1(-medium.thickness(mp.one))
        distance = mp.quad(transmitted, pieces) - passed
        spectrum = mp.quad(lambda t: transmitted(t) * mp.exp(wave_number * t), pieces)
        wave = 1 - passed + wave_number * spectrum
        rgb = ((mass + mp.re(wave * mp.expjpi(2 * mp.mpf(phase)))) / 2 for phase in PHASES)
        red, green, blue = map(float, rgb)
        return Exact(float(mass), float(distance / mass), (red, green, blue))


class Wall(NamedTuple):
    """Constant density on [start, end)."""

    start: float
    end: float
    density: float


def walls(name: str, *pieces: Wall, slack: float = 0.0) -> Medium:
    """Return walls one behind the other, with vacuum between them."""

    def density(t: Tensor) -> Tensor:
        inside = [((t >= wall.start) & (t < wall.end)) * wall.density for wall in pieces]
        return torch.stack(inside).sum(dim=0).to(t.dtype)

    def thickness(t: Any) -> Any:
        return mp.fsum(w.density * max(min(t, w.end) - mp.mpf(w.start), 0) for w in pieces)

    breaks = sorted({t for wall in pieces for t in wall[:2] if 0 < t < 1})
    return Medium(name, density, thickness, tuple(breaks), slack)


def exponential(name: str, start: float, falloff: float) -> Medium:
    """Return start * exp(-falloff t), which thins out from the camera on."""

    def thickness(t: Any) -> Any:
        return -start * mp.expm1(-falloff * t) / falloff

    return Medium(name, lambda t: start * torch.exp(-falloff * t), thickness)


def gaussian(name: str, peak: float, center: float, width: float, slack: float = 0.0) -> Medium:
    """Return peak * exp(-(t - center)^2 / (2 width^2))."""

    def density(t: Tensor) -> Tensor:
        return peak * torch.exp(-(((t - center) / width) ** 2) / 2)

    def thickness(t: Any) -> Any:
        scale = width * mp.sqrt(2)
        rise = mp.erf((t - mp.mpf(center)) / scale) + mp.erf(center / scale)
        return peak * width * mp.sqrt(mp.pi / 2) * rise

    # Light goes out within a fraction of a width, anywhere in the rise of the density.
    places = [center + width * step / 2 for step in range(-12, 13)]
    return Medium(name, density, thickness, tuple(t for t in places if 0 < t < 1), slack)


def cut(name: str, whole: Medium, *windows: tuple[float, float]) -> Medium:
    """Return what a medium has in some windows, with empty space between them."""

    def density(t: Tensor) -> Tensor:
        inside = torch.stack([(t >= begin) & (t <= end) for begin, end in windows]).any(dim=0)
        return whole.density(t) * inside

    def thickness(t: Any) -> Any:
        ends = [(min(t, mp.mpf(begin)), min(t, mp.mpf(end))) for begin, end in windows]
        return mp.fsum(whole.thickness(end) - whole.thickness(begin) for begin, end in ends)

    breaks = tuple(t for window in windows for t in window if 0 < t < 1)
    return Medium(name, density, thickness, breaks, windows=windows)


WINDOWS = ((0.1, 0.16), (0.42, 0.5), (0.8, 0.83))
"""A sixth of the ray."""
THIN = 1 / 768
"""Of shells: a third more than one of 1024 intervals, which no power of two fits by accident."""
PLACE = 0.6
SLACK = 1 / 8
"""One of the fewest intervals, so that a shell lies anywhere between two samples."""
MEDIA = (
    walls("slab", Wall(0.0, 1.0, 3.0)),
    exponential("exponential", start=8.0, falloff=4.0),
    gaussian("gaussian_bump", peak=10.0, center=0.5, width=0.1),
    *(walls(f"shell_1e{n}", Wall(PLACE, PLACE + THIN, 10.0**n), slack=SLACK) for n in (0, 2, 4, 6)),
    gaussian("gaussian_shell", 1e4, PLACE, THIN / math.sqrt(2 * math.pi), slack=SLACK),
    # The first lets half of the light through.
    walls(
        "two_shells",
        Wall(0.3, 0.3 + THIN, 768 * math.log(2)),
        Wall(0.7, 0.7 + THIN, 1e5),
        slack=SLACK,
    ),
    cut("slab_with_gaps", walls("slab", Wall(0.0, 1.0, 10.0)), *WINDOWS),
    cut("exponential_with_gaps", exponential("exponential", start=24.0, falloff=3.0), *WINDOWS),
)
