"""The parts of the box that a trained field leaves empty and that test views need not sample."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from nerfreg.field.radiance_field import RadianceField
from nerfreg.hooks.occupancy import OccupancyGrid

EMPTY_THICKNESS = 1e-3
"""Cells with less optical thickness are empty: a row of 128 of them dims a ray by at most 12 %.

Ten times less made views of the chair scene take 1.7 times as long for 0.001 dB; ten times more
removes haze, at a loss of PSNR (docs/performance.md).
"""

CHUNK = 2**18
"""Number of cells that are evaluated at once, which bounds the memory."""

IsEmpty = Callable[[Tensor], Tensor]
"""Returns which positions (P, 3) are declared empty, (P,)."""

Seen = Callable[[Tensor], tuple[Tensor, float | None]]
"""Returns what the encoder sees in place of positions (P, 3), and how many features are alive."""


def occupied_by(
    field: RadianceField,
    resolution: int,
    empty: IsEmpty | None = None,
    seen: Seen | None = None,
) -> OccupancyGrid:
    """Find the cells of the cube around the scene's box in which the field has density.

    The density is evaluated at one random position in each of the resolution^3 cells. A cell
    counts as occupied if it or one of its 26 neighbours has an optical thickness (density times the
    length of a cell) above `EMPTY_THICKNESS`.

    Args:
        field: The trained field.
        resolution: Cells per side.
        empty: Tells which positions have no density whatever the field says; None: none of them.
        seen: Tells what the encoder sees; None: the positions as they are.
    """
    thickness = _thickness(field, resolution, empty, seen)
    # One sample may miss what a cell contains, so that a neighbour's sample counts as well.
    occupied = _dilate(thickness > EMPTY_THICKNESS)
    # The field covers a cube around the box, and so does the grid.
    return OccupancyGrid.over(field.center, field.half_box, occupied)


@torch.no_grad()
def _thickness(
    field: RadianceField, n: int, empty: IsEmpty | None, seen: Seen | None
) -> Float[Tensor, "x y z"]:
    low, cell, device = field.center - field.half_box, 2 * field.half_box / n, field.center.device
    # A generator of its own: a view must neither vary between calls nor advance the RNG of a run
    # that is evaluated while it trains.
    generator = torch.Generator().manual_seed(0)
    thickness = torch.empty(n**3, device=device)
    for start in range(0, n**3, CHUNK):
        cells = torch.arange(start, min(start + CHUNK, n**3), device=device)
        corner = torch.stack([cells // n**2, cells // n % n, cells % n], dim=1)
        inside = torch.rand(corner.shape, generator=generator).to(device)
        positions = low + (corner + inside) * cell
        given = (positions, None) if seen is None else seen(positions)
        found = field.density(field.raw_density(*given)) * cell
        thickness[cells] = found if empty is None else found.masked_fill(empty(positions), 0)
    return thickness.view(n, n, n)


def _dilate(occupied: Bool[Tensor, "x y z"]) -> Bool[Tensor, "x y z"]:
    return functional.max_pool3d(occupied[None, None].float(), 3, stride=1, padding=1)[0, 0] > 0
