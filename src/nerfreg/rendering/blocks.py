"""Rays of the pixels of an image, in square blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nerfreg.hooks import OccupancyGrid, Rays
from nerfreg.rays.traversal import occupied_runs


@dataclass(frozen=True)
class RayBlocks:
    """The rays of B blocks of P pixels each.

    Attributes:
        origins: (B, P, 3) in world units.
        directions: (B, P, 3) of unit length.
        near: (B, P) where the rays enter the scene.
        far: (B, P) where they leave it.
        points: (B, P, 2) the points (x, y) of the image that they go through, in pixels.
        view: Number of the training view that they belong to, -1 for all other views.
    """

    origins: Float[Tensor, "blocks pixels 3"]
    directions: Float[Tensor, "blocks pixels 3"]
    near: Float[Tensor, "blocks pixels"]
    far: Float[Tensor, "blocks pixels"]
    points: Float[Tensor, "blocks pixels 2"]
    view: int = -1

    @property
    def parts(self) -> tuple[Tensor, ...]:
        """All tensors, in the order of the attributes."""
        return self.origins, self.directions, self.near, self.far, self.points

    def picked(self, blocks: Int[Tensor, " picked"]) -> RayBlocks:
        """Return some of the blocks, by index."""
        origins, directions, near, far, points = (part[blocks] for part in self.parts)
        return RayBlocks(origins, directions, near, far, points, self.view)

    def narrowed(self, cells: OccupancyGrid) -> RayBlocks:
        """Return blocks that lie where rays of this view are in occupied cells.

        All rays begin no nearer than the first of them enters a cell, and end where the last leaves
        one. Rays that meet no cell have no length.
        """
        shape = self.near.shape
        origins, directions, near, far = (part.flatten(0, 1) for part in self.parts[:4])
        runs = occupied_runs(cells, origins, directions, near, far)
        if len(runs.ray) == 0:
            return replace(self, near=self.far)
        # The same distances for all rays, and not those of each: scouts of neighbouring blocks tell
        # each other what they have found by the number of the interval.
        first, last = runs.enter.min(), runs.leave.max()
        near = near.clamp(first, last)
        far = torch.where(runs.met(len(far)), far.clamp(first, last), first)
        return replace(self, near=torch.minimum(near, far).view(shape), far=far.view(shape))

    def to(self, device: torch.device) -> RayBlocks:
        """Return the same blocks on a device."""
        origins, directions, near, far, points = (part.to(device) for part in self.parts)
        return RayBlocks(origins, directions, near, far, points, self.view)

    def flat(self, background: Float[Tensor, " 3"]) -> Rays:
        """Return the rays of all blocks one after the other, in front of one background."""
        origins, directions, near, far, points = (part.flatten(0, 1) for part in self.parts)
        return Rays(
            origins,
            directions,
            near,
            far,
            background=background.to(origins).expand(len(origins), 3),
            view=torch.full((len(origins),), self.view, device=origins.device),
            pixel=points,
        )


def pixel_blocks(
    rows: Int[Tensor, " height"], columns: Int[Tensor, " width"], side: int
) -> Int[Tensor, "y x pixels 2"]:
    """Divide pixels into square blocks.

    Args:
        rows: (H,) rows of the pixels.
        columns: (W,) columns of the pixels.
        side: Side of a block, in pixels.

    Returns:
        (Y, X, side * side, 2) column and row of each pixel of Y x X blocks. Where blocks reach
        beyond the image, its last row and column are repeated.
    """
    rows, columns = (
        torch.cat([line, line[-1:].expand(-len(line) % side)]).view(-1, side)
        for line in (rows, columns)
    )
    y, x = torch.broadcast_tensors(rows[:, None, :, None], columns[None, :, None, :])
    return torch.stack([x, y], dim=-1).flatten(2, 3)
