"""Cells of a box, and which of them are occupied."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor
from torch.nn import functional

BLOCK = 8
"""Side, in cells, of the blocks by which rays cross space that is empty or full; a power of 2."""

EMPTY, MIXED, FULL = 0, 1, 2
"""What the cells of a block are."""


# Tensors have no truth value by which two grids could be compared; a grid equals itself alone.
@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Cubic cells, some of which are occupied.

    Attributes:
        occupied: (X, Y, Z) which cells are occupied.
        low: (3,) lowest corner of the grid, in world units.
        cell: Length of a cell, in world units.
    """

    occupied: Bool[Tensor, "x y z"]
    low: Float[Tensor, " 3"]
    cell: float

    @classmethod
    def over(
        cls, center: Tensor, half_side: float, occupied: Bool[Tensor, "n n n"]
    ) -> OccupancyGrid:
        """Lay n^3 cells over a cube.

        Args:
            center: (3,) centre of the cube, such as `SceneInfo.center`.
            half_side: Half its side, in world units, such as `SceneInfo.half_box`.
            occupied: (n, n, n) which cells are occupied, by x, y and z.
        """
        low = (center - half_side).to(occupied.device)
        return cls(occupied, low, 2 * half_side / len(occupied))

    @cached_property
    def blocks(self) -> UInt8[Tensor, "bx by bz"]:
        """What the cells of each block of 8^3 are: `EMPTY`, `MIXED` or `FULL`.

        Blocks at the end may be smaller.
        """

        def any_of(cells: Bool[Tensor, "x y z"]) -> Bool[Tensor, "bx by bz"]:
            # Padded by False, as max pooling of incomplete blocks would.
            ends = [(0, -n % BLOCK) for n in reversed(cells.shape)]
            padded = functional.pad(cells, [pad for end in ends for pad in end])
            x, y, z = (n // BLOCK for n in padded.shape)
            return padded.view(x, BLOCK, y, BLOCK, z, BLOCK).any(5).any(3).any(1)

        occupied, empty = any_of(self.occupied), any_of(~self.occupied)
        return torch.where(occupied & empty, MIXED, torch.where(occupied, FULL, EMPTY)).byte()

    def to(self, device: torch.device) -> OccupancyGrid:
        """Return the same grid on a device, copied once; itself if it is there."""
        if self.occupied.device == device:
            return self
        if device not in self._copies:
            copy = OccupancyGrid(self.occupied.to(device), self.low.to(device), self.cell)
            self._copies[device] = copy
        return self._copies[device]

    @cached_property
    def _copies(self) -> dict[torch.device, OccupancyGrid]:
        return {}

    @property
    def centers(self) -> Float[Tensor, "x y z 3"]:
        """(X, Y, Z, 3) the centres of all cells, in world units."""
        axes = [torch.arange(n, device=self.low.device) for n in self.occupied.shape]
        cells = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)
        return self.low + (cells + 0.5) * self.cell

    def contains(self, positions: Float[Tensor, "points 3"]) -> Bool[Tensor, " points"]:
        """Return whether each position lies in an occupied cell.

        Args:
            positions: (P, 3) in world units; outside the grid the nearest cell counts.

        Returns:
            (P,) whether the cell is occupied.
        """
        x, y, z = ((positions - self.low) / self.cell).long().unbind(-1)
        nx, ny, nz = self.occupied.shape
        index = (x.clamp_(0, nx - 1) * ny + y.clamp_(0, ny - 1)) * nz + z.clamp_(0, nz - 1)
        return self.occupied.view(-1)[index]
