"""The parts of the box that a trained field leaves empty and that test views need not sample."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from nerfreg.field.radiance_field import RadianceField

EMPTY_THICKNESS = 1e-3
"""Cells with less optical thickness are empty: a row of 128 of them dims a ray by at most 12 %.

Ten times less made views of the chair scene take 1.7 times as long for 0.001 dB; ten times more
removes haze, at a loss of PSNR (docs/performance.md).
"""

CHUNK = 2**18
"""Number of cells that are evaluated at once, which bounds the memory."""


class OccupancyGrid:
    """Cells of the scene's box in which the field has density.

    The density is evaluated at one random position in each of the resolution^3 cells. A cell
    counts as occupied if it or one of its 26 neighbours has an optical thickness (density times the
    length of a cell) above `EMPTY_THICKNESS`.

    Attributes:
        resolution: Cells per side.
        low: (3,) lowest corner of the grid.
        cell: Length of a cell, in world units.
        occupied: (resolution, resolution, resolution) which cells are occupied.
    """

    def __init__(self, field: RadianceField, resolution: int) -> None:
        self.resolution = resolution
        # The field covers a cube around the box, and so does the grid.
        self.low = field.center - field.half_box
        self.cell = 2 * field.half_box / resolution
        # One sample may miss what a cell contains, so that a neighbour's sample counts as well.
        self.occupied = _dilate(self._thickness(field) > EMPTY_THICKNESS)

    def contains(self, positions: Float[Tensor, "points 3"]) -> Bool[Tensor, " points"]:
        """Return whether each position lies in an occupied cell.

        Args:
            positions: (P, 3) in world units; outside the grid the nearest cell counts.

        Returns:
            (P,) whether the cell is occupied.
        """
        index = ((positions - self.low) / self.cell).long().clamp_(0, self.resolution - 1)
        return self.occupied.view(-1)[
            (index[:, 0] * self.resolution + index[:, 1]) * self.resolution + index[:, 2]
        ]

    @torch.no_grad()
    def _thickness(self, field: RadianceField) -> Float[Tensor, "x y z"]:
        n, device = self.resolution, self.low.device
        # A generator of its own: a view must neither vary between calls nor advance the RNG of a
        # run that is evaluated while it trains.
        generator = torch.Generator().manual_seed(0)
        thickness = torch.empty(n**3, device=device)
        for start in range(0, n**3, CHUNK):
            cells = torch.arange(start, min(start + CHUNK, n**3), device=device)
            corner = torch.stack([cells // n**2, cells // n % n, cells % n], dim=1)
            inside = torch.rand(corner.shape, generator=generator).to(device)
            positions = self.low + (corner + inside) * self.cell
            thickness[cells] = field.density(field.raw_density(positions)) * self.cell
        return thickness.view(n, n, n)


def _dilate(occupied: Bool[Tensor, "x y z"]) -> Bool[Tensor, "x y z"]:
    return functional.max_pool3d(occupied[None, None].float(), 3, stride=1, padding=1)[0, 0] > 0
