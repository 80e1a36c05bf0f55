"""Which parts of rays lie in occupied cells of a grid."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from nerfreg.hooks import OccupancyGrid
from nerfreg.rays import traversal_numba

CHUNK = 2**12
"""Rays that are followed at once by the plain traversal, which bounds its memory."""


class Runs(NamedTuple):
    """Parts of rays, M in all, without gaps of their own.

    Those of a ray are ascending and do not touch.

    Attributes:
        ray: (M,) which ray each lies on, ascending.
        enter: (M,) distance at which it begins.
        leave: (M,) distance at which it ends.
    """

    ray: Int[Tensor, " runs"]
    enter: Float[Tensor, " runs"]
    leave: Float[Tensor, " runs"]

    def met(self, rays: int) -> Bool[Tensor, " rays"]:
        """Return which of so many rays have any part, `(rays,)`."""
        found = torch.zeros(rays, dtype=torch.bool, device=self.ray.device)
        found[self.ray] = True
        return found


def occupied_runs(
    grid: OccupancyGrid,
    origins: Float[Tensor, "rays 3"],
    directions: Float[Tensor, "rays 3"],
    near: Float[Tensor, " rays"],
    far: Float[Tensor, " rays"],
) -> Runs:
    """Find the parts of rays between near and far that lie in occupied cells.

    Args:
        grid: The cells; outside of the grid the nearest cell counts, as in `contains`.
        origins: (R, 3) in world units.
        directions: (R, 3) of unit length.
        near: (R,) where each ray begins.
        far: (R,) where it ends; nothing is found where that is not behind `near`.

    Returns:
        The parts, exact but for rounding.
    """
    grid = grid.to(origins.device)
    if origins.device.type == "cpu":
        return Runs(*traversal_numba.occupied_runs(grid, origins, directions, near, far))
    return occupied_runs_plain(grid, origins, directions, near, far)


def occupied_runs_plain(
    grid: OccupancyGrid,
    origins: Float[Tensor, "rays 3"],
    directions: Float[Tensor, "rays 3"],
    near: Float[Tensor, " rays"],
    far: Float[Tensor, " rays"],
) -> Runs:
    """Do the same on any device, by sorting where rays cross the planes between cells."""
    found = []
    for start in range(0, len(origins), CHUNK):
        rows = slice(start, start + CHUNK)
        borders, inside = _cells_along(grid, origins[rows], directions[rows], near[rows], far[rows])
        runs = runs_of_parts(borders, inside)
        found.append(runs._replace(ray=runs.ray + start))
    if not found:
        return Runs(torch.zeros(0, dtype=torch.long, device=near.device), near, far)
    return Runs(*map(torch.cat, zip(*found, strict=True)))


def runs_of_parts(
    borders: Float[Tensor, "rays borders"], inside: Bool[Tensor, "rays parts"]
) -> Runs:
    """Join neighbouring parts of rays.

    Args:
        borders: (R, P+1) ascending borders of the parts.
        inside: (R, P) which of them count; those without length never do.
    """
    lengths = borders.diff(dim=1) > 0
    # Parts without length must not cut what lies on both sides of them: they are moved to the end.
    order = (~lengths).to(torch.uint8).argsort(dim=1, stable=True)
    begins, ends = borders[:, :-1].gather(1, order), borders[:, 1:].gather(1, order)
    inside = (inside & lengths).gather(1, order)
    outside = torch.zeros_like(inside[:, :1])
    padded = torch.cat([outside, inside, outside], dim=1)
    first, last = inside & ~padded[:, :-2], inside & ~padded[:, 2:]
    return Runs(first.nonzero()[:, 0], begins[first], ends[last])


def _cells_along(
    grid: OccupancyGrid, origins: Tensor, directions: Tensor, near: Tensor, far: Tensor
) -> tuple[Float[Tensor, "rays borders"], Bool[Tensor, "rays parts"]]:
    """Return the parts into which the planes between cells divide rays, and which are occupied."""
    # In double, so that parts are as long as they are and not as rounding makes them.
    near, far = near.double()[:, None], far.double()[:, None]
    crossings = [near, far]
    low = grid.low.double()
    for axis, count in enumerate(grid.occupied.shape):
        planes = low[axis] + grid.cell * torch.arange(1, count, device=near.device)
        along = directions[:, axis, None].double()
        # A ray along a plane never crosses it, or lies in it: then nothing is between.
        t = (planes - origins[:, axis, None].double()) / torch.where(along == 0, torch.inf, along)
        crossings.append(torch.where(along == 0, near, t))
    borders = torch.cat(crossings, dim=1).clamp(near, far.maximum(near)).sort(dim=1).values
    middles = (borders[:, 1:] + borders[:, :-1]) / 2
    positions = origins.double()[:, None] + directions.double()[:, None] * middles[..., None]
    inside = grid.contains(positions.view(-1, 3)).view(middles.shape)
    return borders.to(directions.dtype), inside
