"""Matter lies inside the convex hull of what is known, unless photographs insist.

Our own; support planes: Prince and Willsky 1990. What no training view shows, such as the
space below a plate, is otherwise filled with whatever the field happens to make of it. Penalizing
all matter that is not seen takes away the hidden sides of things (docs/choosing.md); outside of the
convex hull of the known points nothing has a hidden side.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Bool, Float
from mpmath import mpf
from torch import Tensor, nn

from nerfreg import OccupancyGrid, Photographs, Regularizer, Rendering, SceneInfo, Step, hookimpl
from nerfreg.errors import NerfregWarning, require_range
from nerfreg.numerics import exact, of_rays, single
from nerfreg_plugins.references import convex_prior as reference

CELLS = 96
"""Cells across the box in which points are counted, and by which the inside is kept."""

CROWD = 4
"""Points that a cell has to hold; fewer may be a mistake."""

ENOUGH = 200
"""Cells that have to hold points; the hull of fewer says little."""

CHUNK = 2**16
"""Positions that are compared with all planes at once, which bounds the memory."""


def outside_opacity(
    tau: Float[Tensor, "rays samples"] | Float[Tensor, "rays samples 1"],
    outside: Bool[Tensor, "rays samples"] | Bool[Tensor, "rays samples 1"],
) -> Float[Tensor, ""]:
    """Return the sum of the opacities 1 - exp(-tau) of samples outside, mean over rays.

    Args:
        tau: Optical thickness of the intervals, `(R, N)` or `(R, N, 1)`.
        outside: Which samples lie outside, of the same shape.
    """
    tau = single(of_rays("tau", tau, 2))
    opacity = torch.where(of_rays("outside", outside, 2), -torch.expm1(-tau), 0.0)
    return opacity.sum() / max(len(tau), 1)


def support_planes(
    points: Float[Tensor, "points 3"], normals: Float[Tensor, "planes 3"], share: float
) -> Float[Tensor, " planes"]:
    """Return how far points reach along each normal, but for the last few.

    Args:
        points: (P, 3).
        normals: (N, 3) of unit length.
        share: Share of the points that are not beyond.
    """
    rank = min(max(math.ceil(share * len(points)), 1), len(points))
    parts = [(points @ some.T).kthvalue(rank, dim=0).values for some in normals.split(16)]
    return torch.cat(parts)


def directions(count: int) -> Float[Tensor, "count 3"]:
    """Return unit vectors spread evenly over the sphere (the Fibonacci lattice)."""
    index = torch.arange(count, dtype=torch.float64)
    z = 1 - (2 * index + 1) / count
    angle = index * math.pi * (3 - math.sqrt(5))
    radius = (1 - z.square()).sqrt()
    return torch.stack([radius * angle.cos(), radius * angle.sin(), z], dim=1).float()


class Planes(nn.Module):
    """The support planes, as checkpoints hold them.

    Attributes:
        offsets: (N,) distance of each plane from the centre of the box, in world units; infinite
            as long as nothing is known.
    """

    offsets: Tensor

    def __init__(self, count: int) -> None:
        super().__init__()
        self.register_buffer("offsets", torch.full((count,), torch.inf))


@dataclass
class ConvexPrior(Regularizer):
    """Opacity outside of the convex hull of known points costs something.

    The points are those of known depth (`stereo`), and those that the scene's files tell of. Where
    too few are known, the plugin does nothing, and says so.

    Attributes:
        weight: Cost of an opaque sample; our own.
        planes: Number of support planes.
        share: Share of the points that planes have on their inner side; the rest may be mistakes.
        growth: How far the hull is grown, as a share of the side of the box.
    """

    weight: float = 1e-3
    planes: int = 400
    share: float = 0.9995
    growth: float = 0.02

    cite: ClassVar[str] = "prince1990convex"

    def __post_init__(self) -> None:
        require_range("reg.convex_prior", self, planes=(4, 10_000), share=(0.5, 1.0))
        require_range("reg.convex_prior", self, growth=(0.0, 10.0))
        # Benches and checks drive the loss without a field; nothing is known then.
        self._forget()

    @hookimpl
    def nerfreg_module(self, scene_info: SceneInfo) -> nn.Module:
        self._forget()
        self._scene = scene_info
        return self._planes

    @hookimpl
    def nerfreg_prepare(self, photographs: Photographs) -> dict[str, Tensor]:
        self._points = _known_points(photographs)
        return {}

    @hookimpl
    def nerfreg_start(self, step: Step) -> None:
        points = self._points.to(self._planes.offsets)
        if len(points):
            points = points[~step.field.empty(points)]
        points, cells = _crowded(points, self._scene)
        del self._points
        if cells < ENOUGH:
            why = f"points are known in {cells} cells of the box, and {ENOUGH} are needed"
            warnings.warn(f"reg.{self.instance}: does nothing: {why}", NerfregWarning, stacklevel=2)
            return
        center = self._scene.center.to(points)
        normals = directions(self.planes).to(points)
        reach = support_planes(points - center, normals, self.share)
        self._planes.offsets.copy_(reach + 2 * self._scene.half_box * self.growth)

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Float[Tensor, ""]]:
        outside = self._outside(rendering)
        return {} if outside is None else {"convex": outside_opacity(rendering.tau, outside)}

    @property
    def scale_free(self) -> bool:
        """True, since opacity has no unit."""
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering) or (outside := self._outside(given)) is None:
            return None
        tau: list[list[mpf]] = exact(given.tau)
        return {"convex": reference.outside_opacity(tau, outside.tolist())}

    def _forget(self) -> None:
        self._planes = Planes(self.planes)
        self._inside: tuple[object, OccupancyGrid | None] = (None, None)

    def _outside(self, rendering: Rendering) -> Bool[Tensor, "rays samples"] | None:
        """Return which samples lie outside of the planes; None if nothing is known."""
        grid = self._grid()
        if grid is None:
            return None
        rays, t = rendering.rays, rendering.t
        positions = rays.origins[:, None] + rays.directions[:, None] * t[..., None]
        return ~grid.contains(positions.detach().view(-1, 3)).view(t.shape)

    def _grid(self) -> OccupancyGrid | None:
        """Return the cells inside of the planes, found again when these change."""
        offsets = self._planes.offsets
        # A checkpoint is restored into the buffer, and moving the field to a device replaces it.
        key = (offsets._version, offsets.data_ptr(), offsets.device, offsets.dtype)
        if key != self._inside[0]:
            known = bool(offsets.isfinite().all())
            self._inside = (key, _inside(offsets, self._scene) if known else None)
        return self._inside[1]


def _known_points(photographs: Photographs) -> Float[Tensor, "points 3"]:
    """Return all points of the scene that are known."""
    found = [torch.zeros(0, 3)]
    depths = [photographs.depth]
    if photographs.known_depth is not None:
        depths.append(photographs.known_depth.mean(dim=-1))
    for depth in depths:
        if depth is None:
            continue
        view, y, x = depth.isfinite().nonzero(as_tuple=True)
        origins, ahead = photographs.cameras.rays(view, torch.stack([x, y], dim=1))
        found.append(origins + ahead * depth[view, y, x, None])
    if photographs.points is not None:
        found.append(photographs.points)
    return torch.cat(found)


def _crowded(
    points: Float[Tensor, "points 3"], scene: SceneInfo
) -> tuple[Float[Tensor, "crowded 3"], int]:
    """Return the points in the box that have others beside them, and the number of their cells."""
    unit = scene.unit(points)
    inside = ((unit >= 0) & (unit < 1)).all(dim=1)
    points, unit = points[inside], unit[inside]
    x, y, z = (unit * CELLS).long().unbind(dim=1)
    cell = (x * CELLS + y) * CELLS + z
    count = torch.bincount(cell, minlength=CELLS**3)
    crowded = count >= CROWD
    return points[crowded[cell]], int(crowded.sum())


def _inside(offsets: Float[Tensor, " planes"], scene: SceneInfo) -> OccupancyGrid:
    """Return which cells of the cube around the box meet the inside of every plane."""
    everywhere = torch.ones((CELLS,) * 3, dtype=torch.bool, device=offsets.device)
    grid = OccupancyGrid.over(scene.center.to(offsets), scene.half_box, everywhere)
    normals = directions(len(offsets)).to(offsets)
    centers = (grid.centers - scene.center.to(offsets)).view(-1, 3)
    # The corner of a cell that lies farthest inside decides, so that no point on the inner side of
    # all planes is taken for one outside.
    reach = offsets + grid.cell / 2 * normals.abs().sum(dim=1)
    inside = torch.cat([(some @ normals.T <= reach).all(dim=1) for some in centers.split(CHUNK)])
    return OccupancyGrid(inside.view_as(everywhere), grid.low, grid.cell)
