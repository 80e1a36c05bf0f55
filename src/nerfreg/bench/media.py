"""Densities along a ray [0, 1] whose optical thickness has a closed form, and what a ray through them truly shows.

The exact opacity, depth and colour are integrals of exp(-thickness) density f(t): in closed form where density is
constant in pieces, by quadrature of 30 digits elsewhere.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
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


def color(t: Float[Tensor, "rays samples"]) -> Float[Tensor, "rays samples 3"]:
    """The colour at distances t: smooth, the same in all media."""
    return (1 + torch.cos(2 * math.pi * (t[..., None] + t.new_tensor(PHASES)))) / 2


class Exact(NamedTuple):
    """What a ray shows: opacity, expected distance, and colour without background."""

    opacity: float
    depth: float
    color: tuple[float, float, float]


class Moments(NamedTuple):
    """Integrals over [0, 1] of exp(-thickness) density times 1, t and exp(2 pi i t), in mpmath."""

    mass: Any
    distance: Any
    wave: Any


@dataclass(frozen=True, kw_only=True)
class Medium(ABC):
    """Density along a ray.

    name, title: in files and in plots. stiff: whether most of it happens in a small part of the ray. slack: how far
    both ends of the ray may be drawn back towards the camera with nothing but vacuum gained or lost.
    """

    name: str
    title: str
    stiff: bool = False
    slack: float = 0.0

    @abstractmethod
    def density(self, t: Float[Tensor, "*points"]) -> Float[Tensor, "*points"]:
        """Density at distances t."""

    @abstractmethod
    def thickness(self, t: Any) -> Any:
        """Optical thickness from 0 to t, an mpmath number, in closed form."""

    @abstractmethod
    def breaks(self) -> tuple[float, ...]:
        """Distances strictly between 0 and 1 that part what is smooth, or steep, from the rest; ascending."""

    def moments(self) -> Moments:
        """By parts, so that nothing but the thickness is needed, and quadrature between the breaks."""
        pieces = [mp.zero, *map(mp.mpf, self.breaks()), mp.one]
        passed, wave_number = mp.exp(-self.thickness(mp.one)), 2j * mp.pi

        def transmitted(t: Any) -> Any:
            return mp.exp(-self.thickness(t))

        distance = mp.quad(transmitted, pieces) - passed
        spread = mp.quad(lambda t: transmitted(t) * mp.exp(wave_number * t), pieces)
        return Moments(
            -mp.expm1(-self.thickness(mp.one)), distance, 1 - passed + wave_number * spread
        )


@cache
def exact(medium: Medium) -> Exact:
    """What a ray through the medium shows."""
    with mp.workdps(DIGITS):
        mass, distance, wave = medium.moments()
        red, green, blue = (
            (mass + mp.re(wave * mp.expjpi(2 * mp.mpf(phase)))) / 2 for phase in PHASES
        )
        return Exact(float(mass), float(distance / mass), (float(red), float(green), float(blue)))


class Wall(NamedTuple):
    """Constant density on [start, end)."""

    start: float
    end: float
    density: float


@dataclass(frozen=True, kw_only=True)
class Walls(Medium):
    """Walls, one behind the other, and vacuum between them."""

    walls: tuple[Wall, ...]

    def density(self, t: Float[Tensor, "*points"]) -> Float[Tensor, "*points"]:
        return sum(
            ((t >= wall.start) & (t < wall.end)) * wall.density for wall in self.walls
        ) + torch.zeros_like(t)

    def thickness(self, t: Any) -> Any:
        return mp.fsum(
            wall.density * max(min(t, wall.end) - mp.mpf(wall.start), 0) for wall in self.walls
        )

    def breaks(self) -> tuple[float, ...]:
        return tuple(sorted({t for wall in self.walls for t in wall[:2] if 0 < t < 1}))

    def moments(self) -> Moments:
        """Each wall's own, times what light the walls before it let through."""
        mass = distance = wave = mp.zero
        for start, end, density in (map(mp.mpf, wall) for wall in self.walls):
            reaching, passed = mp.exp(-self.thickness(start)), mp.exp(-density * (end - start))
            decay = density - 2j * mp.pi
            mass += reaching * (1 - passed)
            distance += reaching * (start + 1 / density - (end + 1 / density) * passed)
            wave += (
                reaching * density * (mp.expjpi(2 * start) - mp.expjpi(2 * end) * passed) / decay
            )
        return Moments(mass, distance, wave)


@dataclass(frozen=True, kw_only=True)
class Exponential(Medium):
    """density exp(-falloff t), thinning out from the camera on."""

    start: float
    falloff: float

    def density(self, t: Float[Tensor, "*points"]) -> Float[Tensor, "*points"]:
        return self.start * torch.exp(-self.falloff * t)

    def thickness(self, t: Any) -> Any:
        return -self.start * mp.expm1(-self.falloff * t) / self.falloff

    def breaks(self) -> tuple[float, ...]:
        return ()


@dataclass(frozen=True, kw_only=True)
class Gaussian(Medium):
    """peak exp(-(t - center)^2 / (2 width^2))."""

    peak: float
    center: float
    width: float

    def density(self, t: Float[Tensor, "*points"]) -> Float[Tensor, "*points"]:
        return self.peak * torch.exp(-(((t - self.center) / self.width) ** 2) / 2)

    def thickness(self, t: Any) -> Any:
        scale = self.width * mp.sqrt(2)
        rise = mp.erf((t - mp.mpf(self.center)) / scale) + mp.erf(self.center / scale)
        return self.peak * self.width * mp.sqrt(mp.pi / 2) * rise

    def breaks(self) -> tuple[float, ...]:
        # Light goes out within a fraction of a width, wherever in the rise of the density that may be.
        places = (self.center + self.width * step / 2 for step in range(-12, 13))
        return tuple(t for t in places if 0 < t < 1)


SHELL_THICKNESS = 1 / 768
"""A third more than one of 1024 intervals: no power of two of them fits it by accident."""
SHELL_DEPTH = 0.6
SLACK = 1 / 8
"""One interval between the fewest samples, so that a shell lies anywhere between two of them."""


def _shell(exponent: int) -> Walls:
    wall = Wall(SHELL_DEPTH, SHELL_DEPTH + SHELL_THICKNESS, 10.0**exponent)
    title = rf"shell, $\sigma = 10^{exponent}$"
    return Walls(name=f"shell_1e{exponent}", title=title, stiff=True, slack=SLACK, walls=(wall,))


MEDIA: tuple[Medium, ...] = (
    Walls(name="slab", title="constant slab", walls=(Wall(0.0, 1.0, 3.0),)),
    Exponential(name="exponential", title="exponential", start=8.0, falloff=4.0),
    Gaussian(name="gaussian_bump", title="Gaussian bump", peak=10.0, center=0.5, width=0.1),
    *map(_shell, (0, 2, 4, 6)),
    Gaussian(
        name="gaussian_shell",
        title=r"Gaussian shell, $\sigma = 10^4$",
        stiff=True,
        slack=SLACK,
        peak=1e4,
        center=SHELL_DEPTH,
        width=SHELL_THICKNESS / math.sqrt(2 * math.pi),
    ),
    Walls(
        name="two_shells",
        title="two shells",
        stiff=True,
        slack=SLACK,
        # The first lets half of the light through.
        walls=(
            Wall(0.3, 0.3 + SHELL_THICKNESS, 768 * math.log(2)),
            Wall(0.7, 0.7 + SHELL_THICKNESS, 1e5),
        ),
    ),
)
