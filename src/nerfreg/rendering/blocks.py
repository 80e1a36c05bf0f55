"""Rays of the pixels of an image, in square blocks."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class RayBlocks:
    """The rays of B blocks of P pixels each.

    Attributes:
        origins: (B, P, 3) in world units.
        directions: (B, P, 3) of unit length.
        near: (B, P) where the rays enter the scene.
        far: (B, P) where they leave it.
    """

    origins: Float[Tensor, "blocks pixels 3"]
    directions: Float[Tensor, "blocks pixels 3"]
    near: Float[Tensor, "blocks pixels"]
    far: Float[Tensor, "blocks pixels"]

    def picked(self, blocks: Int[Tensor, " picked"]) -> RayBlocks:
        """Return some of the blocks, by index."""
        return RayBlocks(
            self.origins[blocks], self.directions[blocks], self.near[blocks], self.far[blocks]
        )

    def to(self, device: torch.device) -> RayBlocks:
        """Return the same blocks on a device."""
        return RayBlocks(
            *(part.to(device) for part in (self.origins, self.directions, self.near, self.far))
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
