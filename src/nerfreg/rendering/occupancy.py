"""Which parts of the box a trained field leaves empty, so that rendering need not look there."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from nerfreg.field.radiance_field import RadianceField

EMPTY_THICKNESS = 1e-3
"""Cells whose optical thickness is below this are empty: a whole row of 128 of them would dim a ray by at most 12 %."""
CHUNK = 2**18


class OccupancyGrid:
    """Cells of the scene's box in which the field has density somewhere.

    The density is looked at in one random place of each of resolution^3 cells; a cell counts as occupied if it or one
    of its 26 neighbours is.
    """

    def __init__(self, field: RadianceField, resolution: int) -> None:
        self.resolution = resolution
        self.low = field.center - field.half_box
        self.cell = 2 * field.half_box / resolution
        self.occupied = _dilate(self._thickness(field) > EMPTY_THICKNESS)

    def contains(self, positions: Float[Tensor, "points 3"]) -> Bool[Tensor, " points"]:
        """Whether each position lies in an occupied cell; positions outside the box take the nearest cell."""
        index = ((positions - self.low) / self.cell).long().clamp_(0, self.resolution - 1)
        return self.occupied.view(-1)[
            (index[:, 0] * self.resolution + index[:, 1]) * self.resolution + index[:, 2]
        ]

    @torch.no_grad()
    def _thickness(self, field: RadianceField) -> Float[Tensor, "x y z"]:
        n, device = self.resolution, self.low.device
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
