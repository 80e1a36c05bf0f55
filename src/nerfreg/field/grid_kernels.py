"""Compiled kernels of the hash grid on the CPU, forward and backward.

All kernels go level by level, so that the table of one level (1 MB at 2^17 entries) stays in the
second-level cache while all points read it. Features are stored feature by feature, so that each is
written as one stream. The forward pass splits the points among the threads. The backward pass to
the table splits the levels, so that no two threads add to the same entry (no atomics) and sums have
the same order for any number of threads.

Arguments that all kernels share: `positions` `(3, P)` in the unit cube; `table` `(E,)`, the two
features of an entry as one complex number; `offsets`, `resolutions` and `dense` of `GridLayout`;
`mask`, the number of entries of a hashed level minus 1; `features` and `grad` `(2 * levels, P)`.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from numba import njit, prange

from nerfreg.field.grid_layout import PRIMES

# Signed, like the coordinates: numba widens a mixture of signed and unsigned numbers. The hash uses
# the low bits of its products alone, and those do not depend on the sign or on an overflow.
PRIME_Y, PRIME_Z = (np.uint32(prime).astype(np.int32) for prime in PRIMES[1:])

# With the literal 1, an int64, numba would compute in float64.
ONE = np.float32(1)

BLOCK = 256
"""Points whose vertices are located at once. Doing so vectorizes, and 256 points of eight vertices
and three fractions (11 kB) stay in the first-level cache until they are used."""

# Fused multiply-adds and the sign of zero may differ from strict arithmetic. Reordering of sums is
# not allowed, so that results do not depend on how a loop was vectorized, nor is the assumption
# that no value is NaN, which could remove the guard in `locate`. Without the interpreter lock
# `in_shares` can run kernels on several threads at once.
COMPILED = {"fastmath": {"contract", "nsz"}, "nogil": True, "cache": True, "error_model": "numpy"}


@no_type_check
@njit(**COMPILED)
def locate(positions, start, count, cells, dense, mask, vertices, inside):
    """Find the cells of a block of points: their vertices' entries, and the place inside the cell.

    Cells are clipped to the grid.

    Args:
        positions: Positions in the unit cube, `(3, P)`.
        start: First point of the block.
        count: Number of points of the block.
        cells: Resolution of the level.
        dense: Whether the level is dense.
        mask: Number of entries of a hashed level, minus 1.
        vertices: Written: entries of the vertices within their level, `(8, BLOCK)`, fastest in x,
            then y, then z.
        inside: Written: place inside the cell, 0 to 1 along x, y and z, `(3, BLOCK)`.
    """
    scale, last, top = np.float32(cells), np.float32(cells - 1), np.int32(cells - 1)
    x_in, y_in, z_in = inside[0], inside[1], inside[2]
    v0, v1, v2, v3 = vertices[0], vertices[1], vertices[2], vertices[3]
    v4, v5, v6, v7 = vertices[4], vertices[5], vertices[6], vertices[7]
    side = np.int32(cells + 1)
    one, zero = np.int32(1), np.int32(0)
    for p in range(count):
        # `positions * cells` in the same order of operations as in `grid_torch`: a rounding that
        # differs would put points near a border into different cells.
        x = positions[0, start + p] * scale
        y = positions[1, start + p] * scale
        z = positions[2, start + p] * scale
        x_low = min(max(np.floor(x), np.float32(0)), last)
        y_low = min(max(np.floor(y), np.float32(0)), last)
        z_low = min(max(np.floor(z), np.float32(0)), last)
        x_in[p], y_in[p], z_in[p] = x - x_low, y - y_low, z - z_low
        # NaN passes through the clipping above, and becomes an arbitrary integer here. Without a
        # second clipping, now of integers, it would read and write outside of the table.
        i = min(max(np.int32(x_low), zero), top)
        j = min(max(np.int32(y_low), zero), top)
        k = min(max(np.int32(z_low), zero), top)
        if dense:
            a = i + side * (j + side * k)
            b = a + side
            c = a + side * side
            d = c + side
            v0[p], v1[p], v2[p], v3[p] = a, a + one, b, b + one
            v4[p], v5[p], v6[p], v7[p] = c, c + one, d, d + one
        else:
            # The factor of x is 1, and y and z have two values each, whose products differ by the
            # prime: two products and four combinations serve all eight vertices.
            i1 = i + one
            y0, z0 = j * PRIME_Y, k * PRIME_Z
            y1, z1 = y0 + PRIME_Y, z0 + PRIME_Z
            a, b, c, d = y0 ^ z0, y1 ^ z0, y0 ^ z1, y1 ^ z1
            v0[p], v1[p], v2[p], v3[p] = (
                (i ^ a) & mask,
                (i1 ^ a) & mask,
                (i ^ b) & mask,
                (i1 ^ b) & mask,
            )
            v4[p], v5[p], v6[p], v7[p] = (
                (i ^ c) & mask,
                (i1 ^ c) & mask,
                (i ^ d) & mask,
                (i1 ^ d) & mask,
            )


@no_type_check
@njit(**COMPILED)
def _gather(entries, vertices, inside, first, second, start, count):
    """Interpolate both features of a level for a block of points.

    `entries` holds the two features of an entry as the parts of a complex number, so that one load
    of 8 bytes fetches both. Writes to `first` and `second`, the two rows of features of the level.
    """
    for p in range(count):
        fx, fy, fz = inside[0, p], inside[1, p], inside[2, p]
        gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
        a, b, c, d = gy * gz, fy * gz, gy * fz, fy * fz
        # An unsigned index needs no test for negative ones, which numba counts from the end.
        e0, e1 = entries[np.uint32(vertices[0, p])], entries[np.uint32(vertices[1, p])]
        e2, e3 = entries[np.uint32(vertices[2, p])], entries[np.uint32(vertices[3, p])]
        e4, e5 = entries[np.uint32(vertices[4, p])], entries[np.uint32(vertices[5, p])]
        e6, e7 = entries[np.uint32(vertices[6, p])], entries[np.uint32(vertices[7, p])]
        # Real and imaginary parts apart: products of complex numbers would cost four
        # multiplications where each weight needs two.
        first[start + p] = (
            a * (gx * e0.real + fx * e1.real)
            + b * (gx * e2.real + fx * e3.real)
            + c * (gx * e4.real + fx * e5.real)
            + d * (gx * e6.real + fx * e7.real)
        )
        second[start + p] = (
            a * (gx * e0.imag + fx * e1.imag)
            + b * (gx * e2.imag + fx * e3.imag)
            + c * (gx * e4.imag + fx * e5.imag)
            + d * (gx * e6.imag + fx * e7.imag)
        )


@no_type_check
@njit(**COMPILED)
def _scatter(entries, vertices, inside, first, second, start, count):
    """Add the gradients of both features to the entries they came from."""
    # One point after the other: several vertices of a hashed level may share an entry, so additions
    # to it must not overtake each other.
    for p in range(count):
        fx, fy, fz = inside[0, p], inside[1, p], inside[2, p]
        gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
        a, b, c, d = gy * gz, fy * gz, gy * fz, fy * fz
        u, v = first[start + p], second[start + p]
        entries[np.uint32(vertices[0, p])] += complex(gx * a * u, gx * a * v)
        entries[np.uint32(vertices[1, p])] += complex(fx * a * u, fx * a * v)
        entries[np.uint32(vertices[2, p])] += complex(gx * b * u, gx * b * v)
        entries[np.uint32(vertices[3, p])] += complex(fx * b * u, fx * b * v)
        entries[np.uint32(vertices[4, p])] += complex(gx * c * u, gx * c * v)
        entries[np.uint32(vertices[5, p])] += complex(fx * c * u, fx * c * v)
        entries[np.uint32(vertices[6, p])] += complex(gx * d * u, gx * d * v)
        entries[np.uint32(vertices[7, p])] += complex(fx * d * u, fx * d * v)


@no_type_check
@njit(**COMPILED)
def _slope(entries, vertices, inside, first, second, start, count, cells, position_grad):
    """Add the gradient that reaches the positions through one level to `position_grad`, `(3, P)`.

    The derivative of trilinear interpolation along an axis is the difference of two opposite faces
    of the cell, interpolated along the other two axes, times the resolution.
    """
    scale = np.float32(cells)
    for p in range(count):
        fx, fy, fz = inside[0, p], inside[1, p], inside[2, p]
        gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
        u, v = first[start + p] * scale, second[start + p] * scale
        e0, e1 = entries[np.uint32(vertices[0, p])], entries[np.uint32(vertices[1, p])]
        e2, e3 = entries[np.uint32(vertices[2, p])], entries[np.uint32(vertices[3, p])]
        e4, e5 = entries[np.uint32(vertices[4, p])], entries[np.uint32(vertices[5, p])]
        e6, e7 = entries[np.uint32(vertices[6, p])], entries[np.uint32(vertices[7, p])]
        # The products with the gradient come first: they reduce both features to one number per
        # vertex, which all three axes share.
        t0, t1 = u * e0.real + v * e0.imag, u * e1.real + v * e1.imag
        t2, t3 = u * e2.real + v * e2.imag, u * e3.real + v * e3.imag
        t4, t5 = u * e4.real + v * e4.imag, u * e5.real + v * e5.imag
        t6, t7 = u * e6.real + v * e6.imag, u * e7.real + v * e7.imag
        position_grad[0, start + p] += (
            gy * gz * (t1 - t0) + fy * gz * (t3 - t2) + gy * fz * (t5 - t4) + fy * fz * (t7 - t6)
        )
        position_grad[1, start + p] += (
            gx * gz * (t2 - t0) + fx * gz * (t3 - t1) + gx * fz * (t6 - t4) + fx * fz * (t7 - t5)
        )
        position_grad[2, start + p] += (
            gx * gy * (t4 - t0) + fx * gy * (t5 - t1) + gx * fy * (t6 - t2) + fx * fy * (t7 - t3)
        )


@no_type_check
@njit(**COMPILED)
def forward_share(positions, table, offsets, resolutions, dense, mask, features, first, stop):
    """Encode the points from `first` to `stop`, level by level."""
    vertices, inside = np.empty((8, BLOCK), np.int32), np.empty((3, BLOCK), np.float32)
    for level in range(len(features) // 2):
        entries = table[offsets[level] : offsets[level + 1]]
        for start in range(first, stop, BLOCK):
            count = min(BLOCK, stop - start)
            locate(
                positions, start, count, resolutions[level], dense[level], mask, vertices, inside
            )
            _gather(
                entries,
                vertices,
                inside,
                features[2 * level],
                features[2 * level + 1],
                start,
                count,
            )


@no_type_check
@njit(parallel=True, **COMPILED)
def forward(positions, table, offsets, resolutions, dense, mask, threads, features):
    """Encode all points; each thread takes a contiguous share of them."""
    points = positions.shape[1]
    share = (points + threads - 1) // threads
    # A loop over threads and not over blocks, so that each thread allocates its buffers once and
    # goes through all of its points before it turns to the next level.
    for thread in prange(threads):
        stop = min(points, (thread + 1) * share)
        forward_share(
            positions, table, offsets, resolutions, dense, mask, features, thread * share, stop
        )


@no_type_check
@njit(parallel=True, **COMPILED)
def backward_table(positions, grad, offsets, resolutions, dense, mask, threads, table_grad):
    """Add the gradient by the table to `table_grad`; each thread takes some of the levels."""
    points, levels = positions.shape[1], len(grad) // 2
    for thread in prange(threads):
        vertices, inside = np.empty((8, BLOCK), np.int32), np.empty((3, BLOCK), np.float32)
        # Every `threads`-th level: the small tables of coarse levels are faster than those of fine
        # ones, so contiguous shares would keep one thread waiting for the other.
        for level in range(thread, levels, threads):
            entries = table_grad[offsets[level] : offsets[level + 1]]
            for start in range(0, points, BLOCK):
                count = min(BLOCK, points - start)
                locate(
                    positions,
                    start,
                    count,
                    resolutions[level],
                    dense[level],
                    mask,
                    vertices,
                    inside,
                )
                _scatter(
                    entries, vertices, inside, grad[2 * level], grad[2 * level + 1], start, count
                )


@no_type_check
@njit(parallel=True, **COMPILED)
def backward_positions(
    positions, table, grad, offsets, resolutions, dense, mask, threads, position_grad
):
    """Add the gradient by the positions to `position_grad`; threads share the points.

    Here threads may split the points: no two of them add to the same place, and the levels add to a
    point in one order.
    """
    points = positions.shape[1]
    share = (points + threads - 1) // threads
    for thread in prange(threads):
        vertices, inside = np.empty((8, BLOCK), np.int32), np.empty((3, BLOCK), np.float32)
        stop = min(points, (thread + 1) * share)
        for level in range(len(grad) // 2):
            cells, entries = resolutions[level], table[offsets[level] : offsets[level + 1]]
            first, second = grad[2 * level], grad[2 * level + 1]
            for start in range(thread * share, stop, BLOCK):
                count = min(BLOCK, stop - start)
                locate(positions, start, count, cells, dense[level], mask, vertices, inside)
                _slope(entries, vertices, inside, first, second, start, count, cells, position_grad)
