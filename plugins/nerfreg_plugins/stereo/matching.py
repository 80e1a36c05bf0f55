"""How unlike two photographs are around pixels that would show the same point. Compiled, for one plane at a time."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from numba import njit

FAINT = 3e-4
"""Variance of colour that is added to that of every window, so that noise alone does not match."""

NO_MATCH = 0.8
"""Cost, 1 - correlation, that no match is above: nothing there looks alike, or it is outside the other photograph."""


COMPILED = {"nogil": True, "cache": True, "error_model": "numpy"}


@no_type_check
@njit(**COMPILED)
def lower_cost(own, other, places, margin, cost):
    """Lower `cost` to 1 - correlation of the windows around the pixels of `own` and around their places in `other`.

    own: (H, W, C), other: (H', W', C) colours. places: (H, W, 2) where the points of own pixels appear in `other`,
    (x, y) in its pixels, or NaN. margin: of a window, (side - 1) / 2; windows end where `own` ends. cost: (H, W),
    changed in place where the place is inside of `other`.
    """
    pixels, inside = _products(own, other, places)
    height, width, sums = pixels.shape
    # Windows slide: what enters is added and what leaves is taken off, in double precision.
    columns = np.zeros((width, sums))
    window = np.zeros(sums)
    for y in range(-margin, height):
        if y + margin < height:
            columns += pixels[y + margin]
        if y < 0:
            continue
        if y - margin - 1 >= 0:
            columns -= pixels[y - margin - 1]
        rows = min(y + margin, height - 1) - max(y - margin, 0) + 1
        window[:] = 0
        for x in range(-margin, width):
            if x + margin < width:
                for s in range(sums):
                    window[s] += columns[x + margin, s]
            if x < 0:
                continue
            if x - margin - 1 >= 0:
                for s in range(sums):
                    window[s] -= columns[x - margin - 1, s]
            if inside[y, x]:
                count = rows * (min(x + margin, width - 1) - max(x - margin, 0) + 1)
                cost[y, x] = min(cost[y, x], 1 - _correlation(window, count))


@no_type_check
@njit(**COMPILED)
def _products(own, other, places):
    """Of each pixel its colour, its colour in `other`, the squares of both and their product; whether it is inside.

    (H, W, 2 C + 3), (H, W). What is outside of `other` has the colour of its border.
    """
    height, width, channels = own.shape
    high, wide = other.shape[:2]
    pixels = np.zeros((height, width, 2 * channels + 3), np.float32)
    inside = np.zeros((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            across, down = places[y, x, 0], places[y, x, 1]
            inside[y, x] = 0 < across < wide and 0 < down < high
            if np.isnan(across) or np.isnan(down):
                across = down = np.float32(0)
            across = min(max(across - np.float32(0.5), np.float32(0)), np.float32(wide - 1))
            down = min(max(down - np.float32(0.5), np.float32(0)), np.float32(high - 1))
            left, top = int(across), int(down)
            right, bottom = min(left + 1, wide - 1), min(top + 1, high - 1)
            u, v = across - left, down - top
            for c in range(channels):
                upper = other[top, left, c] + u * (other[top, right, c] - other[top, left, c])
                lower = other[bottom, left, c] + u * (other[bottom, right, c] - other[bottom, left, c])
                seen, color = upper + v * (lower - upper), own[y, x, c]
                pixels[y, x, c] = color
                pixels[y, x, channels + c] = seen
                pixels[y, x, -3] += color * color
                pixels[y, x, -2] += seen * seen
                pixels[y, x, -1] += color * seen
    return pixels, inside


@no_type_check
@njit(**COMPILED)
def _correlation(window, count):
    """Of the colours in a window, from sums over its `count` pixels of what `_products` gives, (2 C + 3,)."""
    channels = (len(window) - 3) // 2
    own_variance, variance = window[-3] / count + FAINT, window[-2] / count + FAINT
    common = window[-1] / count
    for c in range(channels):
        own_mean, mean = window[c] / count, window[channels + c] / count
        own_variance -= own_mean * own_mean
        variance -= mean * mean
        common -= own_mean * mean
    return common / np.sqrt(own_variance * variance)
