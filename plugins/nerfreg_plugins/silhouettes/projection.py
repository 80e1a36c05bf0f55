"""The compiled projection of cubes into a silhouette."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from numba import njit

COMPILED = {"cache": True, "nogil": True, "error_model": "numpy"}


@no_type_check
@njit(**COMPILED)
def exclude_cubes(
    centers,
    half,
    position,
    rotation,
    focal,
    principal,
    covered,
    beyond,
    has_beyond,
    is_open,
    possible,
):
    """Set `possible` to False where a view rules a cube out; see `PinholeView.exclude`."""
    # How far cubes reach along the axes of the camera.
    reach = half * np.abs(rotation).sum(axis=0)
    rows, columns = covered.shape[0] - 1, covered.shape[1] - 1
    for cube in range(len(centers)):
        if not possible[cube]:
            continue
        x, y, depth = _in_camera(centers[cube], position, rotation)
        front, back = max(depth - reach[2], 0.0), depth + reach[2]
        if back <= 0:
            # What lies behind the camera is not shown.
            possible[cube] = is_open
            continue
        low_x, high_x = _shown(x, reach[0], front, back, focal[0], principal[0])
        low_y, high_y = _shown(y, reach[1], front, back, focal[1], principal[1])
        left, right = _pixels(low_x, high_x, columns)
        top, bottom = _pixels(low_y, high_y, rows)
        seen = _within(covered, left, right, top, bottom) > 0
        if is_open:
            # A cube that the plane of the camera crosses has an infinite rectangle.
            inside = low_x >= 0 and low_y >= 0 and high_x <= columns and high_y <= rows
            seen |= not inside
            seen |= has_beyond and _within(beyond, left, right, top, bottom) > 0
        possible[cube] = seen


@no_type_check
@njit(**COMPILED)
def _in_camera(center, position, rotation):
    dx, dy, dz = center[0] - position[0], center[1] - position[1], center[2] - position[2]
    return (
        dx * rotation[0, 0] + dy * rotation[1, 0] + dz * rotation[2, 0],
        dx * rotation[0, 1] + dy * rotation[1, 1] + dz * rotation[2, 1],
        dx * rotation[0, 2] + dy * rotation[1, 2] + dz * rotation[2, 2],
    )


@no_type_check
@njit(**COMPILED)
def _shown(at, reach, front, back, focal, principal):
    """Return the least and the greatest coordinate of what lies between two depths."""
    low, high = at - reach, at + reach
    # X / Z is extreme at the near end, or at the far one if it lies on one side of the axis. The
    # near end may be the camera itself, at depth 0, and the coordinate then infinite.
    low /= front if low < 0 else back
    high /= front if high > 0 else back
    return focal * low + principal, focal * high + principal


@no_type_check
@njit(**COMPILED)
def _pixels(low, high, count):
    """Return the pixels from first to last but one that an interval meets."""
    return (
        int(min(max(np.floor(low), 0.0), float(count))),
        int(min(max(np.floor(high) + 1, 0.0), float(count))),
    )


@no_type_check
@njit(**COMPILED)
def _within(sums, left, right, top, bottom):
    """Sum over a rectangle of pixels, from the sums at its corners."""
    return sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
