"""Compiled kernels of the hash grid's second derivatives.

The gradient by the positions (`grid_kernels.backward_positions`) is itself a function of positions,
table and incoming gradient; these kernels are its backward pass. They are built like those of
`grid_kernels`, where the shared arguments are explained. `vectors` `(3, P)` is what arrives at each
point.

numba caches a kernel by the date of the file in which it stands, so a change of
`grid_kernels.locate` takes effect here only when this file has changed, too.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from numba import njit, prange

from nerfreg.field.grid_kernels import BLOCK, COMPILED, ONE, locate


@no_type_check
@njit(inline="always", **COMPILED)
def _slopes(fx, fy, fz, ux, uy, uz):
    """Return the directional derivatives of the weights of a cell's eight vertices.

    A weight is a product of one factor per axis, and its derivative follows from the product rule.
    The four products along y and z are shared by the two vertices of an edge along x.
    """
    gx, gy, gz = ONE - fx, ONE - fy, ONE - fz
    a, b, c, d = gy * gz, fy * gz, gy * fz, fy * fz
    da, db = -uy * gz - uz * gy, uy * gz - uz * fy
    dc, dd = uz * gy - uy * fz, uy * fz + uz * fy
    return (
        gx * da - ux * a,
        fx * da + ux * a,
        gx * db - ux * b,
        fx * db + ux * b,
        gx * dc - ux * c,
        fx * dc + ux * c,
        gx * dd - ux * d,
        fx * dd + ux * d,
    )


@no_type_check
@njit(**COMPILED)
def _gather_slopes(entries, vertices, inside, vectors, first, second, start, count, cells):
    """Differentiate both features of a level along the vectors, for a block of points."""
    scale = np.float32(cells)
    for p in range(count):
        q = start + p
        w0, w1, w2, w3, w4, w5, w6, w7 = _slopes(
            inside[0, p],
            inside[1, p],
            inside[2, p],
            vectors[0, q] * scale,
            vectors[1, q] * scale,
            vectors[2, q] * scale,
        )
        e0, e1 = entries[np.uint32(vertices[0, p])], entries[np.uint32(vertices[1, p])]
        e2, e3 = entries[np.uint32(vertices[2, p])], entries[np.uint32(vertices[3, p])]
        e4, e5 = entries[np.uint32(vertices[4, p])], entries[np.uint32(vertices[5, p])]
        e6, e7 = entries[np.uint32(vertices[6, p])], entries[np.uint32(vertices[7, p])]
        first[q] = (
            (w0 * e0.real + w1 * e1.real)
            + (w2 * e2.real + w3 * e3.real)
            + (w4 * e4.real + w5 * e5.real)
            + (w6 * e6.real + w7 * e7.real)
        )
        second[q] = (
            (w0 * e0.imag + w1 * e1.imag)
            + (w2 * e2.imag + w3 * e3.imag)
            + (w4 * e4.imag + w5 * e5.imag)
            + (w6 * e6.imag + w7 * e7.imag)
        )


@no_type_check
@njit(**COMPILED)
def _scatter_slopes(entries, vertices, inside, vectors, first, second, start, count, cells):
    """Add both features' gradients to the entries, by the derivatives of the weights."""
    scale = np.float32(cells)
    for p in range(count):
        q = start + p
        w0, w1, w2, w3, w4, w5, w6, w7 = _slopes(
            inside[0, p],
            inside[1, p],
            inside[2, p],
            vectors[0, q] * scale,
            vectors[1, q] * scale,
            vectors[2, q] * scale,
        )
        u, v = first[q], second[q]
        entries[np.uint32(vertices[0, p])] += complex(w0 * u, w0 * v)
        entries[np.uint32(vertices[1, p])] += complex(w1 * u, w1 * v)
        entries[np.uint32(vertices[2, p])] += complex(w2 * u, w2 * v)
        entries[np.uint32(vertices[3, p])] += complex(w3 * u, w3 * v)
        entries[np.uint32(vertices[4, p])] += complex(w4 * u, w4 * v)
        entries[np.uint32(vertices[5, p])] += complex(w5 * u, w5 * v)
        entries[np.uint32(vertices[6, p])] += complex(w6 * u, w6 * v)
        entries[np.uint32(vertices[7, p])] += complex(w7 * u, w7 * v)


@no_type_check
@njit(**COMPILED)
def _bend(entries, vertices, inside, vectors, first, second, start, count, cells, position_grad):
    """Add the second derivatives times the vectors to `position_grad`, `(3, P)`.

    Trilinear interpolation is linear along each axis, so only the mixed ones are not 0. A mixed
    derivative is the alternating sum over a face of the cell, interpolated along the third axis,
    times the resolution squared.
    """
    scale = np.float32(cells)
    for p in range(count):
        q = start + p
        fx, fy, fz = inside[0, p], inside[1, p], inside[2, p]
        u, v = first[q] * scale, second[q] * scale
        e0, e1 = entries[np.uint32(vertices[0, p])], entries[np.uint32(vertices[1, p])]
        e2, e3 = entries[np.uint32(vertices[2, p])], entries[np.uint32(vertices[3, p])]
        e4, e5 = entries[np.uint32(vertices[4, p])], entries[np.uint32(vertices[5, p])]
        e6, e7 = entries[np.uint32(vertices[6, p])], entries[np.uint32(vertices[7, p])]
        t0, t1 = u * e0.real + v * e0.imag, u * e1.real + v * e1.imag
        t2, t3 = u * e2.real + v * e2.imag, u * e3.real + v * e3.imag
        t4, t5 = u * e4.real + v * e4.imag, u * e5.real + v * e5.imag
        t6, t7 = u * e6.real + v * e6.imag, u * e7.real + v * e7.imag
        xy = (ONE - fz) * ((t3 - t2) - (t1 - t0)) + fz * ((t7 - t6) - (t5 - t4))
        xz = (ONE - fy) * ((t5 - t4) - (t1 - t0)) + fy * ((t7 - t6) - (t3 - t2))
        yz = (ONE - fx) * ((t6 - t4) - (t2 - t0)) + fx * ((t7 - t5) - (t3 - t1))
        ux, uy, uz = vectors[0, q] * scale, vectors[1, q] * scale, vectors[2, q] * scale
        position_grad[0, q] += uy * xy + uz * xz
        position_grad[1, q] += ux * xy + uz * yz
        position_grad[2, q] += ux * xz + uy * yz


@no_type_check
@njit(parallel=True, **COMPILED)
def directional(positions, table, vectors, offsets, resolutions, dense, mask, threads, features):
    """Write the directional derivatives of the features along the vectors; threads share points."""
    points = positions.shape[1]
    share = (points + threads - 1) // threads
    for thread in prange(threads):
        vertices, inside = np.empty((8, BLOCK), np.int32), np.empty((3, BLOCK), np.float32)
        stop = min(points, (thread + 1) * share)
        for level in range(len(features) // 2):
            cells, entries = resolutions[level], table[offsets[level] : offsets[level + 1]]
            first, second = features[2 * level], features[2 * level + 1]
            for start in range(thread * share, stop, BLOCK):
                count = min(BLOCK, stop - start)
                locate(positions, start, count, cells, dense[level], mask, vertices, inside)
                _gather_slopes(
                    entries, vertices, inside, vectors, first, second, start, count, cells
                )


@no_type_check
@njit(parallel=True, **COMPILED)
def directional_table(
    positions, grad, vectors, offsets, resolutions, dense, mask, threads, table_grad
):
    """Add the gradient by the table to `table_grad`; each thread takes some of the levels."""
    points, levels = positions.shape[1], len(grad) // 2
    for thread in prange(threads):
        vertices, inside = np.empty((8, BLOCK), np.int32), np.empty((3, BLOCK), np.float32)
        for level in range(thread, levels, threads):
            cells, entries = resolutions[level], table_grad[offsets[level] : offsets[level + 1]]
            first, second = grad[2 * level], grad[2 * level + 1]
            for start in range(0, points, BLOCK):
                count = min(BLOCK, points - start)
                locate(positions, start, count, cells, dense[level], mask, vertices, inside)
                _scatter_slopes(
                    entries, vertices, inside, vectors, first, second, start, count, cells
                )


@no_type_check
@njit(parallel=True, **COMPILED)
def directional_positions(
    positions, table, grad, vectors, offsets, resolutions, dense, mask, threads, position_grad
):
    """Add the gradient by the positions to `position_grad`; threads share the points."""
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
                _bend(
                    entries,
                    vertices,
                    inside,
                    vectors,
                    first,
                    second,
                    start,
                    count,
                    cells,
                    position_grad,
                )
