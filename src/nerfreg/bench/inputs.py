"""Renderings that losses are measured on: from harmless ones to those where careless forms fail."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor
from torch.nn.functional import pad

from nerfreg.bench.media import color
from nerfreg.hooks import Rays, Rendering
from nerfreg.rendering.compositing import assemble

PATCH = 4
"""Side of the square patches that the rays form; the rays of a patch share their t."""
KNOWN = 0.05
"""Half of what is known of a surface's place, as a share of near to far."""
UNKNOWN = 4
"""Of one ray in so many nothing is known."""


@dataclass(frozen=True)
class LossInput:
    """A kind of ray, with samples from near to far.

    `thickness` is the optical thickness of each interval (R, N), from the place of each ray's
    surface (R, 1) and the middle of each interval (R, N), both 0 at near and 1 at far.
    """

    name: str
    thickness: Callable[[Tensor, Tensor], Tensor]
    near: float = 2.0
    far: float = 6.0

    def rendering(self, rays: int, samples: int, dtype: torch.dtype = torch.float32) -> Rendering:
        """Composite a multiple of PATCH^2 rays from the same random numbers in every dtype."""
        random = partial(
            torch.rand, generator=torch.Generator().manual_seed(samples), dtype=torch.float64
        )
        patches = torch.arange(rays).view(-1, PATCH, PATCH)
        groups = torch.arange(len(patches)).repeat_interleave(PATCH**2)
        # Edges from 0 to 1, those between them anywhere in the middle half of equal parts.
        inner = (torch.arange(samples - 1) + random(len(patches), samples - 1) / 2 + 0.75) / samples
        places = pad(pad(inner, (1, 0)), (0, 1), value=1.0)[groups]
        surface = (0.35 + 0.3 * random(len(patches), 1))[groups] + 0.2 * (random(rays, 1) - 0.5)
        tau = self.thickness(surface, (places[:, 1:] + places[:, :-1]) / 2)
        density = (tau / (places.diff(dim=1) * (self.far - self.near))).to(dtype)
        known = torch.cat([surface - KNOWN, surface + KNOWN], dim=1)
        known[::UNKNOWN] = math.nan
        t_edges, known_depth = (
            (self.near + share * (self.far - self.near)).to(dtype) for share in (places, known)
        )
        t = (t_edges[:, 1:] + t_edges[:, :-1]) / 2
        given = Rays(
            origins=t.new_zeros(rays, 3),
            directions=t.new_tensor([0.0, 0.0, -1.0]).expand(rays, 3),
            near=t_edges[:, 0],
            far=t_edges[:, -1],
            targets=random(rays, 3).to(dtype),
            patches=patches,
            neighbors=torch.stack([patches[:, :, :-1], patches[:, :, 1:]], dim=-1).view(-1, 2),
            unseen=torch.zeros(0, dtype=torch.long),
            groups=groups,
            known_depth=known_depth,
        )
        return assemble(given, t, t_edges, density, lambda *sample: color(t[sample]))


def _bump(surface: Tensor, middle: Tensor) -> Tensor:
    # Thin everywhere, thicker around the surface; about 2 in all, however many intervals.
    return (0.2 + 8 * torch.exp(-(((middle - surface) / 0.1) ** 2) / 2)) / middle.shape[1]


def _wall(haze: float, wall: float, behind: float) -> Callable[[Tensor, Tensor], Tensor]:
    # One interval that is a wall, in haze, and something behind it; thickness of an interval each.
    def thickness(surface: Tensor, middle: Tensor) -> Tensor:
        at = (middle - surface).abs().argmin(dim=1, keepdim=True)
        index = torch.arange(middle.shape[1])
        tau = torch.where(index < at, haze, torch.where(index == at, wall, behind))
        return tau.to(middle.dtype)

    return thickness


INPUTS = (
    # Smooth weights.
    LossInput("benign", _bump),
    # The same where float32 has only ten digits behind the binary point left for t.
    LossInput("packed", _bump, near=10000.0, far=10001.0),
    # One thick interval takes nearly all of the light.
    LossInput("peaked", _wall(haze=1e-6, wall=25.0, behind=1e-6)),
    # Walls, one behind the other: weights behind them vanish, their logarithms do not.
    LossInput("underflow", _wall(haze=1e-9, wall=30.0, behind=30.0)),
)
