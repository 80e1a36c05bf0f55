"""The hash grid in plain torch: the readable reference, and the path on other devices than the CPU."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.field.grid_layout import PRIMES, GridLayout


def encode(
    positions: Float[Tensor, "points 3"],
    table: Float[Tensor, "entries 2"],
    layout: GridLayout,
    levels: int,
) -> Float[Tensor, "points features"]:
    """Interpolate the features of the coarsest `levels` levels at positions in the unit cube, (P, 2 * levels).

    Differentiable in both the table and the positions. Positions outside the cube extrapolate the border cell.
    """
    columns = []
    corners = torch.tensor(
        [[i >> axis & 1 for axis in range(3)] for i in range(8)], device=positions.device
    )
    for level in range(levels):
        cells = int(layout.resolutions[level])
        scaled = positions * cells
        low = scaled.detach().long().clamp(0, cells - 1)
        fraction = (scaled - low)[:, None]
        vertices = low[:, None] + corners
        weights = torch.where(corners == 1, fraction, 1 - fraction).prod(dim=-1)
        if layout.dense[level]:
            x, y, z = vertices.unbind(-1)
            index = x + (cells + 1) * (y + (cells + 1) * z)
        else:
            x, y, z = (vertices[..., axis] * PRIMES[axis] for axis in range(3))
            index = (x ^ y ^ z) & (2**layout.log2_entries - 1)
        columns.append((weights[..., None] * table[index + int(layout.offsets[level])]).sum(dim=1))
    return torch.cat(columns, dim=1) if columns else positions.new_empty(len(positions), 0)
