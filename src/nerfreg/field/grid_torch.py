"""The hash grid in plain torch: the readable reference, and the path on devices without numba."""

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
    """Interpolate the features of the coarsest levels trilinearly.

    Differentiable with respect to both the table and the positions.

    Args:
        positions: Positions in the unit cube, `(P, 3)`. Positions outside of it extrapolate the
            cell at the border.
        table: The features of all levels, `(E, 2)`.
        layout: Resolutions of the levels and their places in the table.
        levels: Number of levels to evaluate, from the coarsest.

    Returns:
        The features, `(P, 2 * levels)`, coarsest level first.
    """
    columns = []
    corners = torch.tensor(
        [[i >> axis & 1 for axis in range(3)] for i in range(8)], device=positions.device
    )
    for level in range(levels):
        cells = int(layout.resolutions[level])
        scaled = positions * cells
        # A position on the upper face belongs to the last cell, whose vertices exist.
        low = scaled.detach().long().clamp(0, cells - 1)
        fraction = (scaled - low)[:, None]
        vertices = low[:, None] + corners
        weights = torch.where(corners == 1, fraction, 1 - fraction).prod(dim=-1)
        if layout.dense[level]:
            x, y, z = vertices.unbind(-1)
            index = x + (cells + 1) * (y + (cells + 1) * z)
        else:
            x, y, z = (vertices[..., axis] * PRIMES[axis] for axis in range(3))
            # The table size is a power of two, so the mask is the modulo of the hash. It keeps low
            # bits alone, which is why `grid_numba` may wrap around in 32 bits and find the same.
            index = (x ^ y ^ z) & (2**layout.log2_entries - 1)
        columns.append((weights[..., None] * table[index + int(layout.offsets[level])]).sum(dim=1))
    return torch.cat(columns, dim=1) if columns else positions.new_empty(len(positions), 0)
