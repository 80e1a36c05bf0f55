"""Reading values at vertices of one level of a hash grid, compiled, with its own backward pass."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, no_type_check

import numpy as np
import torch
from jaxtyping import Int
from numba import get_num_threads, njit, prange
from torch import Tensor

from nerfreg.field import grid_torch
from nerfreg.field.grid_kernels import COMPILED, PRIME_Y, PRIME_Z
from nerfreg.field.grid_layout import FEATURES, GridLayout
from nerfreg.field.grid_shared import SharedTable, apply


class Lookup(NamedTuple):
    """Something that can be read at vertices, plain and compiled.

    Attributes:
        plain: The function in plain torch: of the level's table, `(E, 2)`, vertices `(N, 3)`, the
            layout and the number of the level.
        shape: Shape of what it returns for one vertex.
        kept: Shape of what the backward pass needs of one vertex.
        read: Writes the values. Its arguments are the level's table, `(E,)`, the two features of an
            entry as one complex number; the vertices; resolution, whether the level is dense, mask
            of the hash; the number of threads; the values; what is kept.
        add: Adds the gradient of the entries. Its arguments are that gradient, `(E,)`; the
            vertices; resolution, whether dense, mask; what was kept; the gradient by the values.
    """

    plain: Callable[[Tensor, Tensor, GridLayout, int], Tensor]
    shape: tuple[int, ...]
    kept: tuple[int, ...]
    read: Callable[..., float]
    add: Callable[..., float]


def read(
    lookup: Lookup,
    shared: SharedTable,
    vertices: Int[Tensor, "vertices 3"],
    layout: GridLayout,
    level: int,
) -> Tensor:
    """Read at vertices of a level.

    Args:
        lookup: What to read.
        shared: The table of all levels, float32 on the CPU.
        vertices: Integer coordinates, `(N, 3)`; they must lie in the grid.
        layout: Resolutions of the levels and their places in the table.
        level: Number of the level, from the coarsest.

    Returns:
        The values, `(N, ...)`, differentiable by the table.
    """
    return apply(_Read, shared.table, shared, vertices.contiguous(), lookup, layout, level)


class _Read(torch.autograd.Function):
    """A lookup whose gradient is added to the shared buffer."""

    @staticmethod
    def forward(
        ctx: Any,
        table: Tensor,
        shared: SharedTable,
        vertices: Tensor,
        lookup: Lookup,
        layout: GridLayout,
        level: int,
    ) -> Tensor:
        values = torch.empty(len(vertices), *lookup.shape)
        kept = torch.empty(len(vertices), *lookup.kept)
        lookup.read(
            _pairs(table, layout, level),
            vertices.numpy(),
            *_arguments(layout, level),
            get_num_threads(),
            values.numpy(),
            kept.numpy(),
        )
        ctx.save_for_backward(table, vertices, kept)
        ctx.shared, ctx.lookup, ctx.layout, ctx.level = shared, lookup, layout, level
        return values

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        table, vertices, kept = ctx.saved_tensors
        layout, level = ctx.layout, ctx.level
        nothing = (None,) * 5
        if torch.is_grad_enabled():
            # Second derivatives are rare here. The plain function has them.
            first, stop = layout.offsets[level : level + 2]
            values = ctx.lookup.plain(table[first:stop], vertices, layout, level)
            return *torch.autograd.grad(values, table, grads[0], create_graph=True), *nothing
        buffer, new = ctx.shared.buffer()
        ctx.lookup.add(
            _pairs(buffer, layout, level),
            vertices.numpy(),
            *_arguments(layout, level),
            kept.numpy(),
            grads[0].contiguous().numpy(),
        )
        return buffer if new else None, *nothing


def _pairs(table: Tensor, layout: GridLayout, level: int) -> np.ndarray:
    first, stop = layout.offsets[level : level + 2]
    return table.detach().numpy().view(np.complex64)[first:stop, 0]


def _arguments(layout: GridLayout, level: int) -> tuple[np.int32, bool, np.int32]:
    # Plain numbers, since compiled code knows no dataclass.
    mask = np.int32(2**layout.log2_entries - 1)
    return np.int32(layout.resolutions[level]), bool(layout.dense[level]), mask


@no_type_check
@njit(inline="always", **COMPILED)
def _entry(vertices, p, cells, dense, mask):
    """Return the entry of vertex `p`."""
    i, j, k = np.int32(vertices[p, 0]), np.int32(vertices[p, 1]), np.int32(vertices[p, 2])
    if dense:
        side = cells + np.int32(1)
        return np.uint32(i + side * (j + side * k))
    return np.uint32((i ^ (j * PRIME_Y) ^ (k * PRIME_Z)) & mask)


@no_type_check
@njit(inline="always", **COMPILED)
def _corner(vertices, p, cells, dense, mask):
    """Return the entries of vertex `p` and of the next ones along x, y and z."""
    i, j, k = np.int32(vertices[p, 0]), np.int32(vertices[p, 1]), np.int32(vertices[p, 2])
    one, side = np.int32(1), cells + np.int32(1)
    if dense:
        e = i + side * (j + side * k)
        return np.uint32(e), np.uint32(e + one), np.uint32(e + side), np.uint32(e + side * side)
    y, z = j * PRIME_Y, k * PRIME_Z
    return (
        np.uint32((i ^ y ^ z) & mask),
        np.uint32(((i + one) ^ y ^ z) & mask),
        np.uint32((i ^ (y + PRIME_Y) ^ z) & mask),
        np.uint32((i ^ y ^ (z + PRIME_Z)) & mask),
    )


@no_type_check
@njit(inline="always", **COMPILED)
def _fetch(table, reads):
    """Bring the table into the cache by reading it in order, if as many reads at random follow.

    Reading ahead is what a processor does well, while every first read at random waits for memory:
    16 levels of 2^17 entries are read at 2^15 vertices in 4.1 instead of 5.4 ms, and added to in
    4.2 instead of 6.1 ms. Returns a sum, since a result that nobody uses would not be computed.
    """
    total = np.float32(0)
    # An entry has 8 bytes, and a line of the cache 64.
    if reads * 8 >= len(table):
        for e in range(0, len(table), 8):
            total += table[e].real
    return total


@no_type_check
@njit(parallel=True, **COMPILED)
def _read_features(table, vertices, cells, dense, mask, threads, values, kept):
    share = (len(vertices) + threads - 1) // threads
    total = np.float32(0)
    for thread in prange(threads):
        total += _fetch(table, share)
        for p in range(thread * share, min(len(vertices), (thread + 1) * share)):
            entry = table[_entry(vertices, p, cells, dense, mask)]
            values[p, 0], values[p, 1] = entry.real, entry.imag
    return total


@no_type_check
@njit(**COMPILED)
def _add_features(table_grad, vertices, cells, dense, mask, kept, grad):
    total = _fetch(table_grad, len(vertices))
    # On one thread, one after the other: an entry may come more than once, and the order of the
    # additions must not depend on the number of threads.
    for p in range(len(vertices)):
        table_grad[_entry(vertices, p, cells, dense, mask)] += complex(grad[p, 0], grad[p, 1])
    return total


@no_type_check
@njit(parallel=True, **COMPILED)
def _read_squares(table, vertices, cells, dense, mask, threads, values, kept):
    share = (len(vertices) + threads - 1) // threads
    total = np.float32(0)
    for thread in prange(threads):
        total += _fetch(table, 4 * share)
        for p in range(thread * share, min(len(vertices), (thread + 1) * share)):
            e, ex, ey, ez = _corner(vertices, p, cells, dense, mask)
            here = table[e]
            x, y, z = table[ex] - here, table[ey] - here, table[ez] - here
            # Kept, because reading them as one stream is faster than finding them again.
            kept[p, 0], kept[p, 1], kept[p, 2] = x.real, y.real, z.real
            kept[p, 3], kept[p, 4], kept[p, 5] = x.imag, y.imag, z.imag
            values[p] = (
                (x.real * x.real + x.imag * x.imag)
                + (y.real * y.real + y.imag * y.imag)
                + (z.real * z.real + z.imag * z.imag)
            )
    return total


@no_type_check
@njit(**COMPILED)
def _add_squares(table_grad, vertices, cells, dense, mask, kept, grad):
    total = _fetch(table_grad, 4 * len(vertices))
    for p in range(len(vertices)):
        e, ex, ey, ez = _corner(vertices, p, cells, dense, mask)
        twice = np.float32(2) * grad[p]
        xr, yr, zr = twice * kept[p, 0], twice * kept[p, 1], twice * kept[p, 2]
        xi, yi, zi = twice * kept[p, 3], twice * kept[p, 4], twice * kept[p, 5]
        table_grad[ex] += complex(xr, xi)
        table_grad[ey] += complex(yr, yi)
        table_grad[ez] += complex(zr, zi)
        table_grad[e] -= complex(xr + yr + zr, xi + yi + zi)
    return total


VERTEX_FEATURES = Lookup(
    grid_torch.vertex_features, (FEATURES,), (0,), _read_features, _add_features
)
"""The features of vertices, `(N, 2)`."""

SQUARED_DIFFERENCES = Lookup(
    grid_torch.squared_differences, (), (3 * FEATURES,), _read_squares, _add_squares
)
"""The squared differences from vertices to the next ones, `(N,)`."""
