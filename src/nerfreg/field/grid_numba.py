"""The hash grid on the CPU: the same function as `grid_torch.encode`, compiled and parallel.

Everything goes level by level, so that the table of one level stays in the cache while all points read it, and features
are stored by feature, so that writing them is one stream. Forward splits the points between the threads; backward
splits the levels, so that no two threads add to the same entry and the sums have the same order for any thread count.
"""

from __future__ import annotations

from typing import Any, no_type_check

import numpy as np
import torch
from jaxtyping import Float
from numba import get_num_threads, njit, prange
from torch import Tensor

from nerfreg.field.grid_layout import FEATURES, PRIMES, GridLayout

PRIME_Y, PRIME_Z = np.uint32(PRIMES[1]), np.uint32(PRIMES[2])
ONE = np.float32(1)
PARALLEL = {"parallel": True, "fastmath": {"contract", "nsz"}, "nogil": True, "cache": True, "error_model": "numpy"}


@no_type_check
@njit(inline="always")
def _cell(x, cells):
    """Cell that contains x, clipped to the grid, and how far into the cell x lies."""
    scaled = x * np.float32(cells)
    low = min(max(np.int64(scaled), 0), cells - 1)
    return np.uint32(low), scaled - np.float32(low)


@no_type_check
@njit(inline="always")
def _corners(x, y, z, cells, dense, mask):
    """Table entries of the eight vertices of a cell; x runs fastest, then y, then z."""
    if dense:
        side = np.uint32(cells + 1)
        a = x + side * (y + side * z)
        b = a + side
        c = a + side * side
        d = c + side
        one = np.uint32(1)
        return a, a + one, b, b + one, c, c + one, d, d + one
    x1 = x + np.uint32(1)
    y0, z0 = y * PRIME_Y, z * PRIME_Z
    y1, z1 = y0 + PRIME_Y, z0 + PRIME_Z
    a, b, c, d = y0 ^ z0, y1 ^ z0, y0 ^ z1, y1 ^ z1
    return (
        (x ^ a) & mask, (x1 ^ a) & mask, (x ^ b) & mask, (x1 ^ b) & mask,
        (x ^ c) & mask, (x1 ^ c) & mask, (x ^ d) & mask, (x1 ^ d) & mask,
    )  # fmt: skip


@no_type_check
@njit(**PARALLEL)
def _forward(positions, table, offsets, resolutions, dense, mask, threads, features):
    points = len(positions)
    share = (points + threads - 1) // threads
    for thread in prange(threads):
        for level in range(len(features) // 2):
            cells, is_dense = resolutions[level], dense[level]
            entries = table[offsets[level] : offsets[level + 1]]
            first, second = features[2 * level], features[2 * level + 1]
            for p in range(thread * share, min(points, (thread + 1) * share)):
                x, fx = _cell(positions[p, 0], cells)
                y, fy = _cell(positions[p, 1], cells)
                z, fz = _cell(positions[p, 2], cells)
                i0, i1, i2, i3, i4, i5, i6, i7 = _corners(x, y, z, cells, is_dense, mask)
                gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
                a, b, c, d = gy * gz, fy * gz, gy * fz, fy * fz
                first[p] = (
                    a * (gx * entries[i0, 0] + fx * entries[i1, 0])
                    + b * (gx * entries[i2, 0] + fx * entries[i3, 0])
                    + c * (gx * entries[i4, 0] + fx * entries[i5, 0])
                    + d * (gx * entries[i6, 0] + fx * entries[i7, 0])
                )
                second[p] = (
                    a * (gx * entries[i0, 1] + fx * entries[i1, 1])
                    + b * (gx * entries[i2, 1] + fx * entries[i3, 1])
                    + c * (gx * entries[i4, 1] + fx * entries[i5, 1])
                    + d * (gx * entries[i6, 1] + fx * entries[i7, 1])
                )


@no_type_check
@njit(**PARALLEL)
def _backward_table(positions, grad, offsets, resolutions, dense, mask, threads, table_grad):
    levels = len(grad) // 2
    for thread in prange(threads):
        for level in range(thread, levels, threads):
            cells, is_dense = resolutions[level], dense[level]
            entries = table_grad[offsets[level] : offsets[level + 1]]
            first, second = grad[2 * level], grad[2 * level + 1]
            for p in range(len(positions)):
                x, fx = _cell(positions[p, 0], cells)
                y, fy = _cell(positions[p, 1], cells)
                z, fz = _cell(positions[p, 2], cells)
                i0, i1, i2, i3, i4, i5, i6, i7 = _corners(x, y, z, cells, is_dense, mask)
                gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
                a, b, c, d = gy * gz, fy * gz, gy * fz, fy * fz
                u, v = first[p], second[p]
                for i, w in (
                    (i0, gx * a), (i1, fx * a), (i2, gx * b), (i3, fx * b),
                    (i4, gx * c), (i5, fx * c), (i6, gx * d), (i7, fx * d),
                ):  # fmt: skip
                    entries[i, 0] += w * u
                    entries[i, 1] += w * v


@no_type_check
@njit(**PARALLEL)
def _backward_positions(positions, table, grad, offsets, resolutions, dense, mask, position_grad):
    levels = len(grad) // 2
    for p in prange(len(positions)):
        dx, dy, dz = np.float32(0), np.float32(0), np.float32(0)
        for level in range(levels):
            cells = resolutions[level]
            entries = table[offsets[level] : offsets[level + 1]]
            x, fx = _cell(positions[p, 0], cells)
            y, fy = _cell(positions[p, 1], cells)
            z, fz = _cell(positions[p, 2], cells)
            i0, i1, i2, i3, i4, i5, i6, i7 = _corners(x, y, z, cells, dense[level], mask)
            gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
            u, v = grad[2 * level, p] * np.float32(cells), grad[2 * level + 1, p] * np.float32(cells)
            e0 = u * entries[i0, 0] + v * entries[i0, 1]
            e1 = u * entries[i1, 0] + v * entries[i1, 1]
            e2 = u * entries[i2, 0] + v * entries[i2, 1]
            e3 = u * entries[i3, 0] + v * entries[i3, 1]
            e4 = u * entries[i4, 0] + v * entries[i4, 1]
            e5 = u * entries[i5, 0] + v * entries[i5, 1]
            e6 = u * entries[i6, 0] + v * entries[i6, 1]
            e7 = u * entries[i7, 0] + v * entries[i7, 1]
            dx += gy * gz * (e1 - e0) + fy * gz * (e3 - e2) + gy * fz * (e5 - e4) + fy * fz * (e7 - e6)
            dy += gx * gz * (e2 - e0) + fx * gz * (e3 - e1) + gx * fz * (e6 - e4) + fx * fz * (e7 - e5)
            dz += gx * gy * (e4 - e0) + fx * gy * (e5 - e1) + gx * fy * (e6 - e2) + fx * fy * (e7 - e3)
        position_grad[p, 0], position_grad[p, 1], position_grad[p, 2] = dx, dy, dz


class _Encode(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, positions: Tensor, table: Tensor, layout: GridLayout, levels: int) -> Tensor:
        features = torch.empty(FEATURES * levels, len(positions))
        _forward(
            positions.detach().numpy(), table.detach().numpy(), *_arguments(layout), get_num_threads(), features.numpy()
        )
        ctx.save_for_backward(positions, table)
        ctx.layout = layout
        return features.t()

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        positions, table = (tensor.detach().numpy() for tensor in ctx.saved_tensors)
        grad = grads[0].t().contiguous().numpy()
        table_grad = position_grad = None
        if ctx.needs_input_grad[1]:
            table_grad = torch.zeros(table.shape)
            _backward_table(positions, grad, *_arguments(ctx.layout), get_num_threads(), table_grad.numpy())
        if ctx.needs_input_grad[0]:
            position_grad = torch.empty(positions.shape)
            _backward_positions(positions, table, grad, *_arguments(ctx.layout), position_grad.numpy())
        return position_grad, table_grad, None, None


def _arguments(layout: GridLayout) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.uint32]:
    return layout.offsets, layout.resolutions, layout.dense, np.uint32(2**layout.log2_entries - 1)


def encode(
    positions: Float[Tensor, "points 3"], table: Float[Tensor, "entries 2"], layout: GridLayout, levels: int
) -> Float[Tensor, "points features"]:
    """The same as `grid_torch.encode` for float32 on the CPU; the result is stored feature by feature."""
    return _Encode.apply(positions.contiguous(), table, layout, levels)
