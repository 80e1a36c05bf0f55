"""Compiled kernels that read single entries of the hash grid's table and add to them.

Their plain counterparts are in `grid_torch`. A level's part of the table is `(E, 2)`, float32 on
the CPU; `rows` `(N,)` are the numbers of entries within the level.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Float, Int
from numba import njit
from torch import Tensor

from nerfreg.field.grid_kernels import COMPILED, PRIME_Y, PRIME_Z
from nerfreg.field.grid_layout import FEATURES, GridLayout


def entries(
    vertices: Int[Tensor, "vertices 3"], layout: GridLayout, level: int
) -> Int[Tensor, " vertices"]:
    """Find the entries of vertices within a level, as `grid_torch.entries` does.

    Args:
        vertices: Integer coordinates, 0 to the resolution of the level, `(N, 3)`.
        layout: Resolutions of the levels and their places in the table.
        level: Number of the level, from the coarsest.

    Returns:
        The numbers of the entries, `(N,)`, int32.
    """
    rows = torch.empty(len(vertices), dtype=torch.int32)
    cells, dense = np.int32(layout.resolutions[level]), bool(layout.dense[level])
    mask = np.int32(2**layout.log2_entries - 1)
    _find(vertices.contiguous().numpy(), cells, dense, mask, rows.numpy())
    return rows


def gather(
    table: Float[Tensor, "entries 2"], rows: Int[Tensor, " vertices"]
) -> Float[Tensor, "vertices 2"]:
    """Return the features of entries, `(N, 2)`."""
    features = torch.empty(len(rows), FEATURES)
    _gather(_pairs(table), rows.numpy(), _pairs(features))
    return features


def add(
    table_grad: Float[Tensor, "entries 2"],
    rows: Int[Tensor, " vertices"],
    grad: Float[Tensor, "vertices 2"],
) -> None:
    """Add a gradient by the features, `(N, 2)`, to the gradient of the entries."""
    _add(_pairs(table_grad), rows.numpy(), _pairs(grad.contiguous()))


def _pairs(values: Tensor) -> np.ndarray:
    # Both features as one complex number, so that one load of 8 bytes fetches both.
    return values.detach().numpy().view(np.complex64)[:, 0]


@no_type_check
@njit(**COMPILED)
def _find(vertices, cells, dense, mask, rows):
    side = cells + np.int32(1)
    for p in range(len(rows)):
        i, j, k = np.int32(vertices[p, 0]), np.int32(vertices[p, 1]), np.int32(vertices[p, 2])
        if dense:
            rows[p] = i + side * (j + side * k)
        else:
            rows[p] = (i ^ (j * PRIME_Y) ^ (k * PRIME_Z)) & mask


@no_type_check
@njit(**COMPILED)
def _gather(table, rows, features):
    for p in range(len(rows)):
        features[p] = table[np.uint32(rows[p])]


@no_type_check
@njit(**COMPILED)
def _add(table_grad, rows, grad):
    # One after the other: an entry may come more than once.
    for p in range(len(rows)):
        table_grad[np.uint32(rows[p])] += grad[p]
