"""Convex solids with procedural textures under one light, and an exact ray tracer for them."""

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
"""Distance off a surface at which shadow rays start, so that rounding causes no self-shadowing."""


class Shape(NamedTuple):
    """A convex solid of about unit size around the origin.

    Attributes:
        intersect: From origins and directions to the distances at which rays enter and leave,
            `(P,)` each. Rays miss where enter >= leave.
        normal: From points on the surface to outward normals, `(P, 3)`, of any length.
    """

    intersect: Callable[[Points, Points], tuple[Tensor, Tensor]]
    normal: Callable[[Points], Points]


def _intersect_sphere(o: Points, d: Points) -> tuple[Tensor, Tensor]:
    return _roots(_dot(d, d), _dot(o, d), _dot(o, o) - 1)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    # Column by column: torch's reductions over such a short axis are several times slower.
    return functools.reduce(
        torch.add, ((x * y) for x, y in zip(a.unbind(-1), b.unbind(-1), strict=True))
    )


def _roots(a: Tensor, half_b: Tensor, c: Tensor) -> tuple[Tensor, Tensor]:
    """Where a t^2 + 2 half_b t + c <= 0 begins and ends.

    Nowhere is (inf, -inf), everywhere (-inf, inf).
    """
    discriminant = half_b * half_b - a * c
    root = discriminant.clamp_min(0).sqrt()
    # A ray along the axis of a cylinder: no quadratic is left, and the ray is inside or outside the
    # mantle for good.
    level = a < 1e-12
    miss = torch.where(level, c > 0, discriminant <= 0)
    safe = torch.where(level, 1.0, a)
    enter = torch.where(level, -math.inf, (-half_b - root) / safe)
    leave = torch.where(level, math.inf, (-half_b + root) / safe)
    return enter.masked_fill(miss, math.inf), leave.masked_fill(miss, -math.inf)


def _intersect_box(o: Tensor, d: Tensor) -> tuple[Tensor, Tensor]:
    """Where -1 <= o + t d <= 1 holds along all axes; o, d: `(P, axes)`."""
    # A direction of 0 becomes a tiny one, so that the planes are very far away instead of at NaN.
    inverse = 1 / torch.where(d.abs() < 1e-12, 1e-12, d)
    first, second = (-1 - o) * inverse, (1 - o) * inverse
    enter, leave = torch.minimum(first, second).unbind(-1), torch.maximum(first, second).unbind(-1)
    return functools.reduce(torch.maximum, enter), functools.reduce(torch.minimum, leave)


def _intersect_cylinder(o: Points, d: Points) -> tuple[Tensor, Tensor]:
    side_o, side_d = o[:, :2], d[:, :2]
    enter, leave = _roots(_dot(side_d, side_d), _dot(side_o, side_d), _dot(side_o, side_o) - 1)
    top_enter, top_leave = _intersect_box(o[:, 2:], d[:, 2:])
    return torch.maximum(enter, top_enter), torch.minimum(leave, top_leave)


def _box_normal(p: Points) -> Points:
    # The coordinate of greatest magnitude is the one that lies on a face.
    return one_hot(p.abs().argmax(-1), 3) * p.sign()


def _cylinder_normal(p: Points) -> Points:
    on_cap = p[:, 2:].abs() > p[:, :2].norm(dim=-1, keepdim=True)
    return torch.where(on_cap, p * p.new_tensor([0, 0, 1]), p * p.new_tensor([1, 1, 0]))


SPHERE = Shape(_intersect_sphere, lambda p: p)
BOX = Shape(_intersect_box, _box_normal)
CYLINDER = Shape(_intersect_cylinder, _cylinder_normal)


@dataclass(frozen=True)
class Texture:
    """Two colours and how they alternate over the coordinates of a solid, in world units.

    A texture of space and not of the surface: it needs no surface coordinates, and its details have
    the same size on every side.

    Attributes:
        pattern: "checker", "stripes", "marble" or "dots".
        colors: The two colours.
        period: Period of the pattern in world units.
        phase: Shift of the pattern along each axis, in periods.
    """

    pattern: str
    colors: Float[Tensor, "2 3"]
    period: float
    phase: Float[Tensor, " 3"]

    def __call__(self, p: Points) -> Points:
        """Compute the colours at points in the coordinates of the solid, `(P, 3)`."""
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
        colors: Tensor = first + share[:, None] * (second - first)
        return colors


@dataclass(frozen=True)
class Solid:
    """A shape that is scaled, rotated about the vertical and moved.

    Attributes:
        shape: The shape of about unit size.
        center: Where it is, in the world.
        half_size: Half its size along its own x, y and z axes.
        texture: Its colours.
        rotation: Angle about the vertical, in radians.
        gloss: Strength of the highlight.
    """

    shape: Shape
    center: tuple[float, float, float]
    half_size: tuple[float, float, float]
    texture: Texture
    rotation: float = 0.0
    gloss: float = 0.3

    def intersect(self, origins: Points, directions: Points) -> tuple[Tensor, Tensor]:
        """Compute the distances at which rays of the world enter and leave.

        Args:
            origins: Origins of the rays, `(P, 3)`.
            directions: Their directions, `(P, 3)`.

        Returns:
            The distances, `(P,)` each. A ray misses the solid if it enters no earlier than it
            leaves.
        """
        # Directions are not normalized again after scaling, so distances are those of the world.
        to_local: Tensor = self._axes(origins) / origins.new_tensor(self.half_size)
        return self.shape.intersect(
            (origins - origins.new_tensor(self.center)) @ to_local, directions @ to_local
        )

    def surface(self, points: Points) -> tuple[Points, Points]:
        """Compute colours and unit normals on the surface.

        Args:
            points: Points on the surface, in the world, `(P, 3)`.

        Returns:
            Colours and normals, `(P, 3)` each.
        """
        axes, half_size = self._axes(points), points.new_tensor(self.half_size)
        local = (points - points.new_tensor(self.center)) @ axes
        # Normals scale inversely to points, or they would not stay orthogonal to a scaled surface.
        normals = self.shape.normal(local / half_size) / half_size
        return self.texture(local), normalize(normals @ axes.T, dim=-1)

    def _axes(self, like: Tensor) -> Float[Tensor, "3 3"]:
        c, s = math.cos(self.rotation), math.sin(self.rotation)
        axes: Tensor = like.new_tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        return axes


@dataclass(frozen=True)
class RayTracer:
    """Solids under one distant light, with Blinn-Phong shading and hard shadows.

    Attributes:
        solids: The solids.
        light: The direction towards the light, of any length.
        ambient: Share of the diffuse light that reaches every surface.
        shininess: Exponent of the highlights.
    """

    solids: Sequence[Solid]
    light: tuple[float, float, float] = (0.35, -0.55, 0.75)
    ambient: float = 0.4
    shininess: float = 30.0

    def trace(
        self, origins: Points, directions: Points
    ) -> tuple[Float[Tensor, " points"], Int[Tensor, " points"]]:
        """Find the first solid along each ray.

        Args:
            origins: Origins of the rays, `(P, 3)`, outside of all solids.
            directions: Unit directions, `(P, 3)`.

        Returns:
            The distances, inf where there is no solid, and the indices of the solids, `(P,)` each.
        """
        distance = torch.full_like(origins[:, 0], math.inf)
        index = torch.zeros_like(distance, dtype=torch.long)
        for number, solid in enumerate(self.solids):
            enter, leave = solid.intersect(origins, directions)
            first = (enter < leave) & (enter > 0) & (enter < distance)
            distance = torch.where(first, enter, distance)
            index = index.masked_fill(first, number)
        return distance, index

    def shade(self, origins: Points, directions: Points) -> tuple[Points, Bool[Tensor, " points"]]:
        """Compute the colours that rays see.

        Args:
            origins: Origins of the rays, `(P, 3)`, outside of all solids.
            directions: Unit directions, `(P, 3)`.

        Returns:
            Colours, `(P, 3)`, 0 where there is nothing, and whether there is something, `(P,)`.
        """
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
        light = normalize(points.new_tensor(self.light), dim=-1)
        shadow, _ = self.trace(points + SHADOW_GAP * normals, light.expand_as(points))
        halfway = normalize(light - directions[hit], dim=-1)
        facing = normals @ light
        # A surface turned away from the light is dark even if its shadow ray, which starts inside
        # the solid, meets nothing.
        lit = (shadow.isinf() & (facing > 0)).to(points)[:, None]
        highlight = (normals * halfway).sum(-1, keepdim=True).clamp_min(0) ** self.shininess
        diffuse = self.ambient + (1 - self.ambient) * facing.clamp_min(0)[:, None] * lit
        colors[hit] = (albedo * diffuse + gloss * highlight * lit).clamp(0, 1)
        return colors, hit
