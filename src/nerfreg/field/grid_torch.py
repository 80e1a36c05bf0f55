"""The hash grid in plain torch: the readable reference, and the path on devices without numba."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from nerfreg.field.grid_layout import PRIMES, GridLayout


def encode(
    positions: Float[Tensor, "points 3"],
    table: Float[Tensor, "entries 2"],
    layout: GridLayout,
    levels: int,
) -> Float[Tensor, "points features"]:
    """Interpolate the features of the coarsest levels trilinearly.

    Differentiable with respect to both the table and the positions, any number of times.

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
        index = entries(vertices, layout, level) + int(layout.offsets[level])
        columns.append((weights[..., None] * table[index]).sum(dim=1))
    return torch.cat(columns, dim=1) if columns else positions.new_empty(len(positions), 0)


def gradient(
    positions: Float[Tensor, "points 3"],
    grad: Float[Tensor, "points features"],
    table: Float[Tensor, "entries 2"],
    layout: GridLayout,
) -> Float[Tensor, "points 3"]:
    """Take a gradient by the features to the positions.

    Args:
        positions: Positions in the unit cube, `(P, 3)`.
        grad: Gradient by the features of the coarsest levels, `(P, 2 * levels)`.
        table: The features of all levels, `(E, 2)`.
        layout: Resolutions of the levels and their places in the table.

    Returns:
        The sum over the features of `grad` times the derivative of the feature, `(P, 3)`,
        differentiable by all three tensors.
    """
    if not grad.shape[1]:
        return torch.zeros_like(positions)
    recorded = torch.is_grad_enabled()
    with torch.enable_grad():
        if not positions.requires_grad:
            positions = positions.detach().requires_grad_()
        features = encode(positions, table, layout, grad.shape[1] // 2)
        return torch.autograd.grad(features, positions, grad, create_graph=recorded)[0]


def entries(vertices: Int[Tensor, "*any 3"], layout: GridLayout, level: int) -> Int[Tensor, "*any"]:
    """Find the entries of vertices within a level.

    Args:
        vertices: Integer coordinates, 0 to the resolution of the level, `(..., 3)`.
        layout: Resolutions of the levels and their places in the table.
        level: Number of the level, from the coarsest.

    Returns:
        The numbers of the entries, `(...)`.
    """
    x, y, z = vertices.long().unbind(-1)
    if layout.dense[level]:
        side = int(layout.resolutions[level]) + 1
        return x + side * (y + side * z)
    # The table size is a power of two, so the mask is the modulo of the hash. It keeps low bits
    # alone, which is why the kernels may wrap around in 32 bits and find the same.
    x, y, z = x * PRIMES[0], y * PRIMES[1], z * PRIMES[2]
    hashed: Tensor = (x ^ y ^ z) & (2**layout.log2_entries - 1)
    return hashed


def vertex_features(
    table: Float[Tensor, "entries 2"],
    vertices: Int[Tensor, "vertices 3"],
    layout: GridLayout,
    level: int,
) -> Float[Tensor, "vertices 2"]:
    """Look up the features of vertices of a level.

    Args:
        table: The features of that level alone, `(E, 2)`.
        vertices: Integer coordinates, 0 to the resolution of the level, `(N, 3)`.
        layout: Resolutions of the levels and their places in the table.
        level: Number of the level, from the coarsest.

    Returns:
        The features, `(N, 2)`.
    """
    features: Tensor = table[entries(vertices, layout, level)]
    return features


def squared_differences(
    table: Float[Tensor, "entries 2"],
    vertices: Int[Tensor, "vertices 3"],
    layout: GridLayout,
    level: int,
) -> Float[Tensor, " vertices"]:
    """Compute how much the features change from vertices to the next ones along x, y and z.

    Args:
        table: The features of that level alone, `(E, 2)`.
        vertices: Integer coordinates, 0 to the resolution of the level minus 1, `(N, 3)`.
        layout: Resolutions of the levels and their places in the table.
        level: Number of the level, from the coarsest.

    Returns:
        The squared differences, summed over features and axes, `(N,)`.
    """
    steps = torch.eye(3, dtype=torch.int64, device=vertices.device)
    here = table[entries(vertices, layout, level)]
    following = table[entries(vertices[:, None] + steps, layout, level)]
    return (following - here[:, None]).square().sum(dim=(1, 2))
