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
        """Return blocks whose rays begin and end in occupied cells.

        Rays that meet none have no length, and lie where the first ray of their block begins.
        """
        shape = self.near.shape
        origins, directions, near, far = (part.flatten(0, 1) for part in self.parts[:4])
        runs = occupied_runs(cells, origins, directions, near, far)
        begin, end = torch.full_like(near, torch.inf), torch.full_like(near, -torch.inf)
        begin = begin.scatter_reduce(0, runs.ray, runs.enter, "amin").view(shape)
        end = end.scatter_reduce(0, runs.ray, runs.leave, "amax").view(shape)
        first = begin.amin(dim=1, keepdim=True)
        # A block that meets nothing at all stays where it was.
        first = torch.where(first.isfinite(), first, self.far.amin(dim=1, keepdim=True))
        met = end > begin
        return replace(self, near=torch.where(met, begin, first), far=torch.where(met, end, first))

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
