"""The compiled traversal of a grid, from cell to cell (Amanatides and Woo 1987)."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from nerfreg.hooks import OccupancyGrid
from nerfreg.hooks.occupancy import BLOCK, MIXED

COMPILED = {"cache": True, "nogil": True, "error_model": "numpy"}

ROOM = 64
"""Runs of a ray for which there is room at first; nearly all rays have fewer."""

SHIFT = BLOCK.bit_length() - 1
"""Cells are counted in blocks by shifts: divisions would take most of the time."""


def occupied_runs(
    grid: OccupancyGrid, origins: Tensor, directions: Tensor, near: Tensor, far: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return ray, beginning and end of each part of a ray that lies in occupied cells.

    See `nerfreg.rays.traversal.occupied_runs`, whose arguments these are.
    """
    cells = (grid.occupied.contiguous().view(torch.uint8).numpy(), grid.blocks.numpy())
    rays = [part.detach().float().contiguous().numpy() for part in (origins, directions, near, far)]
    room, counts = ROOM, np.zeros(len(origins), dtype=np.int64)
    while True:
        runs = np.empty((len(origins), room, 2), dtype=np.float32)
        _follow_all(*cells, grid.low.double().numpy(), float(grid.cell), *rays, counts, runs)
        most = int(counts.max(initial=0))
        if most <= room:
            break
        room = most
    written = np.arange(room) < counts[:, None]
    found = torch.from_numpy(runs[written]).to(near.dtype)
    ray = torch.from_numpy(np.repeat(np.arange(len(origins)), counts))
    return ray, found[:, 0], found[:, 1]


@no_type_check
@njit(parallel=True, **COMPILED)
def _follow_all(occupied, blocks, low, cell, origins, directions, near, far, counts, runs):
    for ray in prange(len(origins)):
        counts[ray] = _follow(
            occupied, blocks, low, cell, origins[ray], directions[ray], near[ray], far[ray],
            runs[ray],
        )  # fmt: skip


@no_type_check
@njit(**COMPILED)
def _follow(occupied, blocks, low, cell, origin, direction, near, far, runs):
    """Follow one ray, write its runs as far as there is room, and count them."""
    if not far > near:
        return 0
    t, end = np.float64(near), np.float64(far)
    nx, ny, nz = occupied.shape
    # Scalars and no arrays of three: the compiler keeps them in registers.
    x, by_x, start_x, per_x = _begin(low[0], cell, origin[0], direction[0], t, nx)
    y, by_y, start_y, per_y = _begin(low[1], cell, origin[1], direction[1], t, ny)
    z, by_z, start_z, per_z = _begin(low[2], cell, origin[2], direction[2], t, nz)
    count, inside, begin, last = 0, False, np.float32(near), np.float32(-np.inf)
    while t < end:
        state = blocks[x >> SHIFT, y >> SHIFT, z >> SHIFT]
        # Blocks whose cells are all alike are crossed in one step.
        shift = 0 if state == MIXED else SHIFT
        to_x = _exit(x, by_x, start_x, per_x, nx, shift)
        to_y = _exit(y, by_y, start_y, per_y, ny, shift)
        to_z = _exit(z, by_z, start_z, per_z, nz, shift)
        leaves = min(min(to_x, to_y), min(to_z, end))
        # Rounding may put a plane before the place that has been reached.
        if leaves > t:
            full = occupied[x, y, z] != 0
            at = np.float32(t)
            if full and not inside:
                # A gap that rounding leaves without length is none either: the run goes on.
                if count > 0 and at == last:
                    count -= 1
                else:
                    begin = at
            # A run that rounding leaves without length is none.
            if inside and not full and at > begin:
                if count < len(runs):
                    runs[count, 0], runs[count, 1] = begin, at
                count, last = count + 1, at
            inside = full
            t = leaves
        x = _next(x, by_x, to_x <= leaves, start_x, per_x, leaves, nx, shift)
        y = _next(y, by_y, to_y <= leaves, start_y, per_y, leaves, ny, shift)
        z = _next(z, by_z, to_z <= leaves, start_z, per_z, leaves, nz, shift)
    if inside and np.float32(end) > begin:
        if count < len(runs):
            runs[count, 0], runs[count, 1] = begin, np.float32(end)
        count += 1
    return count


@no_type_check
@njit(**COMPILED)
def _begin(low, cell, origin, along, t, cells):
    """Return the cell in which a ray begins along an axis, its step, and where it meets planes.

    It meets plane i at the distance that is the third number plus i times the fourth.
    """
    offset, slope = np.float64(origin) - low, np.float64(along)
    # Outside of the grid the nearest cell counts.
    index = min(max(int(np.floor((offset + t * slope) / cell)), 0), cells - 1)
    if slope == 0:
        return index, 0, 0.0, np.inf
    return index, 1 if slope > 0 else -1, -offset / slope, cell / slope


@no_type_check
@njit(**COMPILED)
def _exit(index, by, start, per_cell, cells, shift):
    """Return where a ray leaves its cell, or its block of cells, along an axis."""
    if by == 0:
        return np.inf
    plane = ((index >> shift) + (1 if by > 0 else 0)) << shift
    # From the plane itself and not by adding steps, whose rounding would add up. Outside of the
    # grid there are no planes.
    return start + plane * per_cell if 0 < plane < cells else np.inf


@no_type_check
@njit(**COMPILED)
def _next(index, by, leaves_here, start, per_cell, t, cells, shift):
    """Return the cell along an axis after a cell, or a block of cells, was left at t."""
    first = (index >> shift) << shift
    if leaves_here:
        return first + (1 << shift) if by > 0 else first - 1
    if shift == 0 or by == 0:
        return index
    # Somewhere in the same block.
    inside = int(np.floor((t - start) / per_cell))
    return min(max(inside, first), min(first + (1 << shift), cells) - 1)
