"""PatchMatch stereo (Bleyer, Rhemann, Rother 2011; Galliani, Lasinger, Schindler 2015): every pixel keeps the best
piece of surface that it has heard of, neighbours pass theirs on, and small changes improve it. Compiled."""

from __future__ import annotations

from typing import NamedTuple, no_type_check

import numpy as np
from numba import njit

FAINT = 3e-4
"""Variance of colour that is added to that of every window, so that noise alone does not match."""

ALIKE = 0.2
"""Distance of colours at which a pixel of a window counts a quarter of what its middle counts."""

NO_MATCH = 2.0
"""Cost, 1 - correlation, that no match is above."""

DOUBTED, MOST = 0.1, 4.0
"""What it costs to be one gap away from where another photograph believes a surface to be; how many gaps count."""

LARGEST = 0.1
"""Change of inverse depth, as a share of its range, that is tried first."""

STEEPEST = 4.0
"""Tangent of the largest slope, against the image, that a piece of surface can have."""

COMPILED = {"nogil": True, "cache": True, "error_model": "numpy"}


class Comparison(NamedTuple):
    """One view and the sources that it is compared with.

    own: (H, W, C) colours; others: (S, H, W, C). ahead: (S, H, W, 3), shift: (S, 3): the point of a pixel at inverse
    depth w appears in source s at (x / z, y / z) of (x, y, z) = ahead + w shift. believed: (S, H, W) inverse depths of
    the sources, along their own axes; NaN where nothing is. gap: how far two inverse depths of one surface may differ.
    focal: in pixels. reach, step: a window has every step-th pixel, `reach` of them either way.
    """

    own: np.ndarray
    others: np.ndarray
    ahead: np.ndarray
    shift: np.ndarray
    believed: np.ndarray
    gap: np.float32
    focal: np.float32
    reach: int
    step: int


@no_type_check
@njit(**COMPILED)
def patch_match(views, there, nearest, farthest, guesses, sweeps, changes, seed, planes, cost):
    """Improve `planes`, (H, W, 3), and their `cost`, (H, W), in place, at pixels that are `there`, (H, W).

    A plane is the inverse depth w of its pixel along the optical axis, and its slopes (p, q) in x and y: i pixels to
    the right and j down its inverse depth is w (1 + (p i + q j) / focal). w = 0 is none yet. nearest, farthest: the
    largest and the smallest inverse depth. guesses: tried at random in each pixel first. sweeps: over the image, there
    and back in turn. changes: of each pixel in each sweep, each smaller than the one before.
    """
    np.random.seed(seed)
    height, width = there.shape
    window = _window(views)
    for y in range(height):
        for x in range(width):
            if there[y, x]:
                _look(views, y, x, window)
                _begin(views, y, x, window, nearest, farthest, guesses, planes, cost)
    for sweep in range(sweeps):
        forth = sweep % 2 == 0
        for row in range(height):
            y = row if forth else height - 1 - row
            for column in range(width):
                x = column if forth else width - 1 - column
                if there[y, x]:
                    _look(views, y, x, window)
                    _hear(
                        views,
                        y,
                        x,
                        window,
                        nearest,
                        farthest,
                        there,
                        -1 if forth else 1,
                        planes,
                        cost,
                    )
                    size = np.float32(LARGEST * 0.5**sweep)
                    _change(views, y, x, window, nearest, farthest, changes, size, planes, cost)


@no_type_check
@njit(**COMPILED)
def _begin(views, y, x, window, nearest, farthest, guesses, planes, cost):
    """With what is there, or a random plane."""
    w, p, q = planes[y, x]
    cost[y, x] = _cost(views, y, x, window, w, p, q) if w > 0 else 2 * NO_MATCH
    for _ in range(guesses):
        w = farthest + (nearest - farthest) * np.float32(np.random.random())
        _try(
            views,
            y,
            x,
            window,
            w,
            np.float32(np.random.normal()),
            np.float32(np.random.normal()),
            planes,
            cost,
        )


@no_type_check
@njit(**COMPILED)
def _hear(views, y, x, window, nearest, farthest, there, back, planes, cost):
    """Of the planes of two neighbours, as they go on here."""
    height, width = there.shape
    for j, i in ((0, back), (back, 0)):
        if 0 <= y + j < height and 0 <= x + i < width and there[y + j, x + i]:
            w, p, q = planes[y + j, x + i]
            here = w * (1 - (p * i + q * j) / views.focal)
            if farthest <= here <= nearest:
                _try(views, y, x, window, here, p * w / here, q * w / here, planes, cost)


@no_type_check
@njit(**COMPILED)
def _change(views, y, x, window, nearest, farthest, changes, size, planes, cost):
    """A little of everything, at first by up to `size` of the range of inverse depth."""
    for _ in range(changes):
        w, p, q = planes[y, x]
        w += size * (nearest - farthest) * _either_way()
        p += 5 * size * _either_way()
        q += 5 * size * _either_way()
        if farthest <= w <= nearest and abs(p) < STEEPEST and abs(q) < STEEPEST:
            _try(views, y, x, window, w, p, q, planes, cost)
        size *= np.float32(0.4)


@no_type_check
@njit(**COMPILED)
def _either_way():
    return np.float32(2 * np.random.random() - 1)


@no_type_check
@njit(**COMPILED)
def _try(views, y, x, window, w, p, q, planes, cost):
    new = _cost(views, y, x, window, w, p, q)
    if new < cost[y, x]:
        cost[y, x] = new
        planes[y, x, 0], planes[y, x, 1], planes[y, x, 2] = w, p, q


@no_type_check
@njit(**COMPILED)
def _window(views):
    """Room for a window of P pixels: weights (P,), own colours and those of a source (C, P), own variance (1,)."""
    pixels, channels = (2 * views.reach + 1) ** 2, views.own.shape[2]
    colors = np.zeros((2, channels, pixels), np.float32)
    return np.zeros(pixels, np.float32), colors[0], colors[1], np.zeros(1, np.float32)


@no_type_check
@njit(**COMPILED)
def _look(views, y, x, window):
    """Fill a window with what surrounds a pixel: weights, which sum to 1, and colours, less their mean, times those."""
    weights, own, _, variance = window
    height, width, channels = views.own.shape
    side = 2 * views.reach + 1
    weights[:] = 0
    for k in range(len(weights)):
        row, column = (
            y + (k // side - views.reach) * views.step,
            x + (k % side - views.reach) * views.step,
        )
        if 0 <= row < height and 0 <= column < width:
            unlike = np.float32(0)
            for c in range(channels):
                own[c, k] = views.own[row, column, c]
                unlike += (own[c, k] - views.own[y, x, c]) ** 2
            weights[k] = 1 / (1 + unlike / np.float32(ALIKE**2)) ** 2
    weights /= weights.sum()
    variance[0] = 0
    for c in range(channels):
        mean = np.float32(0)
        for k in range(len(weights)):
            mean += weights[k] * own[c, k]
        for k in range(len(weights)):
            off = own[c, k] - mean
            own[c, k] = weights[k] * off
            variance[0] += own[c, k] * off


@no_type_check
@njit(**COMPILED)
def _cost(views, y, x, window, w, p, q):
    """1 - correlation of a window with the two sources that are most like it, on average; and what they believe."""
    least, second = np.float32(NO_MATCH), np.float32(np.inf)
    height, width = views.own.shape[:2]
    for s in range(len(views.shift)):
        z = views.ahead[s, y, x, 2] + w * views.shift[s, 2]
        if z <= 0:
            continue
        across = (views.ahead[s, y, x, 0] + w * views.shift[s, 0]) / z
        down = (views.ahead[s, y, x, 1] + w * views.shift[s, 1]) / z
        if not (0 < across < width and 0 < down < height):
            continue
        _see(views, s, y, x, window, w, p, q)
        cost = 1 - _correlation(window)
        off = abs(w / z - views.believed[s, int(down), int(across)]) / views.gap
        if not np.isnan(off):
            cost += np.float32(DOUBTED) * min(off, np.float32(MOST))
        if cost < least:
            least, second = cost, least
        elif cost < second:
            second = cost
    return least if second >= NO_MATCH else (least + second) / 2


@no_type_check
@njit(**COMPILED, fastmath=True)
def _see(views, s, y, x, window, w, p, q):
    """Fill a window with the colours that source s shows of a piece of surface; outside those of its border."""
    weights, _, seen, _ = window
    others, reach, step = views.others, views.reach, views.step
    _, height, width, channels = others.shape
    k = -1
    for j in range(-reach * step, reach * step + 1, step):
        for i in range(-reach * step, reach * step + 1, step):
            k += 1
            if weights[k] == 0:
                continue
            at = w * (1 + (p * i + q * j) / views.focal)
            z = 1 / max(views.ahead[s, y + j, x + i, 2] + at * views.shift[s, 2], np.float32(1e-6))
            u = (views.ahead[s, y + j, x + i, 0] + at * views.shift[s, 0]) * z - np.float32(0.5)
            v = (views.ahead[s, y + j, x + i, 1] + at * views.shift[s, 1]) * z - np.float32(0.5)
            u = min(max(u, np.float32(0)), np.float32(width - 1))
            v = min(max(v, np.float32(0)), np.float32(height - 1))
            left, top = int(u), int(v)
            right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
            u -= left
            v -= top
            for c in range(channels):
                upper = others[s, top, left, c] + u * (
                    others[s, top, right, c] - others[s, top, left, c]
                )
                lower = others[s, bottom, left, c] + u * (
                    others[s, bottom, right, c] - others[s, bottom, left, c]
                )
                seen[c, k] = upper + v * (lower - upper)


@no_type_check
@njit(**COMPILED, fastmath=True)
def _correlation(window):
    """Of the colours in a window, each about its own mean, with those of a source."""
    weights, own, seen, variance = window
    squares, common = np.float32(0), np.float32(0)
    for c in range(len(seen)):
        mean = np.float32(0)
        for k in range(len(weights)):
            mean += weights[k] * seen[c, k]
            squares += weights[k] * seen[c, k] ** 2
            common += own[c, k] * seen[c, k]
        squares -= mean**2
    faint = np.float32(FAINT)
    return common / np.sqrt((variance[0] + faint) * (max(squares, np.float32(0)) + faint))
