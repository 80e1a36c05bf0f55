"""Convex solids with procedural textures, lit by one lamp, traced exactly."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import normalize, one_hot

Points = Float[Tensor, "points 3"]
SHADOW_GAP = 1e-4
"""Shadow rays start this far off the surface, lest a solid shadow itself by rounding."""


class Shape(NamedTuple):
    """A convex solid of about unit size around the origin.

    crossing: origins, directions -> the distances (P,) at which rays enter and leave; they miss where enter >= leave.
    normal: points on the surface -> outward normals (P, 3), not normalised.
    """

    crossing: Callable[[Points, Points], tuple[Tensor, Tensor]]
    normal: Callable[[Points], Points]


def _ball_crossing(o: Points, d: Points) -> tuple[Tensor, Tensor]:
    return _roots(_dot(d, d), _dot(o, d), _dot(o, o) - 1)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    # Column by column: a reduction over so short an axis is several times slower.
    return functools.reduce(
        torch.add, ((x * y) for x, y in zip(a.unbind(-1), b.unbind(-1), strict=True))
    )


def _roots(a: Tensor, half_b: Tensor, c: Tensor) -> tuple[Tensor, Tensor]:
    """Where a t^2 + 2 half_b t + c <= 0 begins and ends; nowhere or everywhere is (inf, -inf), (-inf, inf)."""
    discriminant = half_b * half_b - a * c
    root = discriminant.clamp_min(0).sqrt()
    level = a < 1e-12
    miss = torch.where(level, c > 0, discriminant <= 0)
    safe = torch.where(level, 1.0, a)
    enter = torch.where(level, -math.inf, (-half_b - root) / safe)
    leave = torch.where(level, math.inf, (-half_b + root) / safe)
    return enter.masked_fill(miss, math.inf), leave.masked_fill(miss, -math.inf)


def _slab_crossing(o: Tensor, d: Tensor) -> tuple[Tensor, Tensor]:
    """Where -1 <= o + t d <= 1 along each axis, then along all of them; o, d: (P, axes)."""
    inverse = 1 / torch.where(d.abs() < 1e-12, 1e-12, d)
    first, second = (-1 - o) * inverse, (1 - o) * inverse
    enter, leave = torch.minimum(first, second).unbind(-1), torch.maximum(first, second).unbind(-1)
    return functools.reduce(torch.maximum, enter), functools.reduce(torch.minimum, leave)


def _drum_crossing(o: Points, d: Points) -> tuple[Tensor, Tensor]:
    side_o, side_d = o[:, :2], d[:, :2]
    enter, leave = _roots(_dot(side_d, side_d), _dot(side_o, side_d), _dot(side_o, side_o) - 1)
    top_enter, top_leave = _slab_crossing(o[:, 2:], d[:, 2:])
    return torch.maximum(enter, top_enter), torch.minimum(leave, top_leave)


def _block_normal(p: Points) -> Points:
    return one_hot(p.abs().argmax(-1), 3) * p.sign()


def _drum_normal(p: Points) -> Points:
    on_cap = p[:, 2:].abs() > p[:, :2].norm(dim=-1, keepdim=True)
    return torch.where(on_cap, p * p.new_tensor([0, 0, 1]), p * p.new_tensor([1, 1, 0]))


BALL = Shape(_ball_crossing, lambda p: p)
BLOCK = Shape(_slab_crossing, _block_normal)
DRUM = Shape(_drum_crossing, _drum_normal)


@dataclass(frozen=True)
class Texture:
    """Two colours and how they alternate over the solid's own coordinates, in world units.

    pattern: "checker", "stripes", "marble" or "dots". period: its size. phase: (3,) shifts it.
    """

    pattern: str
    colors: Float[Tensor, "2 3"]
    period: float
    phase: Float[Tensor, " 3"]

    def __call__(self, p: Points) -> Points:
        """Colours (P, 3) at points (P, 3)."""
        wave = torch.sin(2 * math.pi * (p / self.period + self.phase.to(p)))
        if self.pattern == "checker":
            share = (wave.prod(-1) > 0).to(p)
        elif self.pattern == "stripes":
            share = 0.5 + 0.5 * wave[:, 2]
        elif self.pattern == "dots":
            share = (wave.sum(-1) > 0.8).to(p)
        else:
            share = 0.5 + 0.5 * torch.sin(3 * wave[:, 0] + 2 * wave[:, 1] + wave[:, 2])
        first, second = self.colors.to(p)
        return first + share[:, None] * (second - first)


@dataclass(frozen=True)
class Solid:
    """A shape, stretched by half its size along x, y, z, turned about the vertical (radians), and put at a place."""

    shape: Shape
    place: tuple[float, float, float]
    half_size: tuple[float, float, float]
    texture: Texture
    turn: float = 0.0
    gloss: float = 0.3

    def crossing(self, origins: Points, directions: Points) -> tuple[Tensor, Tensor]:
        """Distances (P,) at which rays of the world enter and leave."""
        to_local: Tensor = self._axes(origins) / origins.new_tensor(self.half_size)
        return self.shape.crossing(
            (origins - origins.new_tensor(self.place)) @ to_local, directions @ to_local
        )

    def surface(self, points: Points) -> tuple[Points, Points]:
        """Colours and unit normals, (P, 3) each, at points on the surface."""
        axes, half_size = self._axes(points), points.new_tensor(self.half_size)
        local = (points - points.new_tensor(self.place)) @ axes
        normals = self.shape.normal(local / half_size) / half_size
        return self.texture(local), normalize(normals @ axes.T, dim=-1)

    def _axes(self, like: Tensor) -> Float[Tensor, "3 3"]:
        c, s = math.cos(self.turn), math.sin(self.turn)
        axes: Tensor = like.new_tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        return axes


@dataclass(frozen=True)
class Still:
    """Solids and the direction towards the lamp; shading after Blinn and Phong, with hard shadows."""

    solids: Sequence[Solid]
    lamp: tuple[float, float, float] = (0.35, -0.55, 0.75)
    ambient: float = 0.4
    shininess: float = 30.0

    def trace(
        self, origins: Points, directions: Points
    ) -> tuple[Float[Tensor, " points"], Int[Tensor, " points"]]:
        """Distance along unit rays to the first solid, (P,), inf where there is none; and which solid that is.

        The rays start outside all solids.
        """
        distance = torch.full_like(origins[:, 0], math.inf)
        index = torch.zeros_like(distance, dtype=torch.long)
        for number, solid in enumerate(self.solids):
            enter, leave = solid.crossing(origins, directions)
            first = (enter < leave) & (enter > 0) & (enter < distance)
            distance = torch.where(first, enter, distance)
            index = index.masked_fill(first, number)
        return distance, index

    def shade(self, origins: Points, directions: Points) -> tuple[Points, Bool[Tensor, " points"]]:
        """Colours (P, 3) of unit rays, and which of them hit something, (P,); colours are 0 elsewhere."""
        distance, index = self.trace(origins, directions)
        hit = distance.isfinite()
        colors = torch.zeros_like(origins)
        points = origins[hit] + distance[hit, None] * directions[hit]
        albedo, normals, gloss = (
            torch.zeros_like(points),
            torch.zeros_like(points),
            torch.zeros_like(points[:, :1]),
        )
        for number, solid in enumerate(self.solids):
            mine = index[hit] == number
            albedo[mine], normals[mine] = solid.surface(points[mine])
            gloss[mine] = solid.gloss
        lamp = normalize(points.new_tensor(self.lamp), dim=-1)
        shadow, _ = self.trace(points + SHADOW_GAP * normals, lamp.expand_as(points))
        halfway = normalize(lamp - directions[hit], dim=-1)
        facing = normals @ lamp
        lit = (shadow.isinf() & (facing > 0)).to(points)[:, None]
        highlight = (normals * halfway).sum(-1, keepdim=True).clamp_min(0) ** self.shininess
        diffuse = self.ambient + (1 - self.ambient) * facing.clamp_min(0)[:, None] * lit
        colors[hit] = (albedo * diffuse + gloss * highlight * lit).clamp(0, 1)
        return colors, hit
