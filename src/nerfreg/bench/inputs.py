"""Renderings that losses are measured on: from harmless ones to those where careless forms lose their digits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.bench.media import color
from nerfreg.hooks import Rays, Rendering
from nerfreg.rendering.compositing import MIN_WEIGHT, composite

PATCH = 4
"""Side of the square patches that the rays form; the rays of a patch share their t."""
KNOWN = 0.05
"""Half of what is known of a surface's place, as a share of near to far."""
UNKNOWN = 4
"""Of one ray in so many nothing is known."""


@dataclass(frozen=True)
class Input:
    """A kind of ray.

    name, about: in files and in plots. near, far: where the samples lie. thickness: optical thickness of each interval
    (R, N), from the place of each ray's surface (R, 1) and the middle of each interval (R, N), 0 at near and 1 at far.
    """

    name: str
    about: str
    near: float
    far: float
    thickness: Callable[[Tensor, Tensor], Tensor]

    def rendering(self, rays: int, samples: int, dtype: torch.dtype = torch.float32) -> Rendering:
        """Composited in `dtype` from the same random numbers in every dtype. rays: a multiple of PATCH^2."""
        generator = torch.Generator().manual_seed(samples)
        patches = torch.arange(rays).view(-1, PATCH, PATCH)
        places = _ascending(len(patches), samples, generator).repeat_interleave(PATCH**2, dim=0)
        surface = 0.35 + 0.3 * torch.rand(len(patches), 1, generator=generator, dtype=torch.float64)
        surface = surface.repeat_interleave(PATCH**2, dim=0)
        surface = surface + 0.2 * (
            torch.rand(rays, 1, generator=generator, dtype=torch.float64) - 0.5
        )
        tau = self.thickness(surface, (places[:, 1:] + places[:, :-1]) / 2)
        density = tau / (places.diff(dim=1) * (self.far - self.near))
        t_edges = (self.near + places * (self.far - self.near)).to(dtype)
        known = torch.cat([surface - KNOWN, surface + KNOWN], dim=1)
        known[::UNKNOWN] = math.nan
        known_depth = (self.near + known * (self.far - self.near)).to(dtype)
        return _rendering(density.to(dtype), t_edges, known_depth, patches, generator)


def _bump(
    surface: Float[Tensor, "rays 1"], middle: Float[Tensor, "rays samples"]
) -> Float[Tensor, "rays samples"]:
    """Thin everywhere, thicker around the surface; about 2 in all, however many intervals."""
    return (0.2 + 8 * torch.exp(-(((middle - surface) / 0.1) ** 2) / 2)) / middle.shape[1]


def _wall(haze: float, wall: float, behind: float) -> Callable[[Tensor, Tensor], Tensor]:
    """One interval as thick as a wall, haze before it and something behind it, in the thickness of an interval."""

    def thickness(
        surface: Float[Tensor, "rays 1"], middle: Float[Tensor, "rays samples"]
    ) -> Tensor:
        at = (middle - surface).abs().argmin(dim=1, keepdim=True)
        index = torch.arange(middle.shape[1])
        return torch.where(index < at, haze, torch.where(index == at, wall, behind)).to(
            middle.dtype
        )

    return thickness


INPUTS = (
    Input("benign", "smooth weights, t from 2 to 6", 2.0, 6.0, _bump),
    Input("packed", "the same, t from 10000 to 10001", 10000.0, 10001.0, _bump),
    Input(
        "peaked", "one thick interval in haze", 2.0, 6.0, _wall(haze=1e-6, wall=25.0, behind=1e-6)
    ),
    Input(
        "underflow",
        "walls, weights behind them vanish",
        2.0,
        6.0,
        _wall(haze=1e-9, wall=30.0, behind=30.0),
    ),
)


def _ascending(rays: int, samples: int, generator: torch.Generator) -> Float[Tensor, "rays edges"]:
    """Edges from 0 to 1, those between them anywhere in the middle half of equal parts."""
    inner = torch.rand(rays, samples - 1, generator=generator, dtype=torch.float64) / 2 + 0.75
    inner = (torch.arange(samples - 1) + inner) / samples
    ends = torch.tensor([[0.0, 1.0]], dtype=torch.float64).expand(rays, 2)
    return torch.cat([ends[:, :1], inner, ends[:, 1:]], dim=1)


def _rendering(
    density: Float[Tensor, "rays samples"],
    t_edges: Float[Tensor, "rays edges"],
    known_depth: Float[Tensor, "rays 2"],
    patches: Tensor,
    generator: torch.Generator,
) -> Rendering:
    rays = len(density)
    t = (t_edges[:, 1:] + t_edges[:, :-1]) / 2
    result = composite(density, color(t), t_edges)
    assert result.rgb is not None
    direction = t.new_tensor([0.0, 0.0, -1.0]).expand(rays, 3)
    across = torch.stack([patches[:, :, :-1], patches[:, :, 1:]], dim=-1).view(-1, 2)
    return Rendering(
        rays=Rays(
            origins=t.new_zeros(rays, 3),
            directions=direction,
            near=t_edges[:, 0],
            far=t_edges[:, -1],
            targets=torch.rand(rays, 3, generator=generator, dtype=torch.float64).to(t.dtype),
            patches=patches,
            neighbors=across,
            unseen=torch.zeros(0, dtype=torch.long),
            groups=torch.arange(len(patches)).repeat_interleave(PATCH**2),
            known_depth=known_depth,
        ),
        t_edges=t_edges,
        t=t,
        density=density,
        tau=result.tau,
        log_transmittance=result.log_transmittance,
        weights=result.weights,
        opacity=result.opacity,
        depth=result.depth,
        rgb=result.rgb,
        colored=result.weights > MIN_WEIGHT,
    )
