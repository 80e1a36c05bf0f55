"""PatchMatch stereo, compiled.

Every pixel keeps the best piece of surface that it has been offered. Neighbours pass theirs on, and
small random changes improve it.

Source: Bleyer, Rhemann, Rother 2011 (slanted windows); Galliani, Lasinger, Schindler 2015 (several
source views).
"""

# One module for search and cost: numba's cache notices changes of the file that a function stands
# in, but not of those that it calls in other files, and would go on running the old ones.

from __future__ import annotations

from typing import NamedTuple, no_type_check

import numpy as np
from numba import njit

VARIANCE_FLOOR = 3e-4
"""Variance of colour that is added to that of every window, so that noise alone does not match."""

COLOR_SCALE = 0.2
"""Distance of colours at which a pixel of a window counts a quarter of what its middle counts."""

NO_MATCH = 2.0
"""Cost, 1 - correlation, that no match is above."""

DISAGREEMENT, MOST_DISAGREEMENT = 0.1, 4.0
"""What it costs to be one gap away from where a source has its surface; how many gaps count."""

LARGEST_CHANGE = 0.1
"""Change of inverse depth, as a share of its range, that is tried first."""

MAX_SLOPE = 4.0
"""Tangent of the largest slope, against the image, that a piece of surface can have."""

# numpy's error model divides by 0 without a check in the inner loops; the formulas below either
# cannot divide by 0 or take the infinity as it is meant. Without the GIL the views of a scene are
# searched in parallel.
COMPILED = {"nogil": True, "cache": True, "error_model": "numpy"}


class MatchingProblem(NamedTuple):
    """One view and the source views that it is compared with.

    The point of a pixel at inverse depth w appears in source s at (x / z, y / z) of
    (x, y, z) = at_infinity[s] + w epipole[s].

    Attributes:
        image: Colours of the view, `(H, W, C)`.
        sources: Colours of the sources, `(S, H, W, C)`.
        at_infinity: `(S, H, W, 3)`.
        epipole: `(S, 3)`.
        source_depths: Inverse depths that the sources have found, along their own axes,
            `(S, H, W)`; NaN where they have none.
        gap: How far two inverse depths of one surface may differ.
        focal: Focal length of the view in pixels.
        reach: Pixels that a window has either way of its middle.
        stride: Distance of the pixels of a window.
    """

    image: np.ndarray
    sources: np.ndarray
    at_infinity: np.ndarray
    epipole: np.ndarray
    source_depths: np.ndarray
    gap: np.float32
    focal: np.float32
    reach: int
    stride: int


@no_type_check
@njit(**COMPILED)
def patch_match(problem, mask, nearest, farthest, guesses, sweeps, changes, seed, planes, cost):
    """Improve planes and their cost in place.

    A plane is the inverse depth w of its pixel along the optical axis, and its slopes (p, q) in x
    and y: i pixels to the right and j down, its inverse depth is w (1 + (p i + q j) / focal).

    Args:
        problem: A `MatchingProblem`.
        mask: Pixels to search, `(H, W)`.
        nearest: Largest inverse depth.
        farthest: Smallest inverse depth.
        guesses: Random planes tried in each pixel first.
        sweeps: Passes over the image, there and back in turn.
        changes: Changes tried of each pixel in each sweep, each smaller than the one before.
        seed: Of the random numbers.
        planes: `(H, W, 3)`; w = 0 is none yet.
        cost: `(H, W)`.
    """
    # numba's generator is the thread's own. Seeded here, a view gets the same numbers whichever
    # thread searches it.
    np.random.seed(seed)
    height, width = mask.shape
    window = _new_window(problem)
    for y in range(height):
        for x in range(width):
            if mask[y, x]:
                _load_window(problem, y, x, window)
                _initialize(problem, y, x, window, nearest, farthest, guesses, planes, cost)
    for sweep in range(sweeps):
        # Each sweep runs against the one before, so that a good plane crosses the image in two
        # sweeps, whichever way it has to go.
        forth = sweep % 2 == 0
        back = -1 if forth else 1
        for row in range(height):
            y = row if forth else height - 1 - row
            for column in range(width):
                x = column if forth else width - 1 - column
                if mask[y, x]:
                    _load_window(problem, y, x, window)
                    limits = nearest, farthest
                    _propagate(problem, y, x, window, limits, mask, back, planes, cost)
                    size = np.float32(LARGEST_CHANGE * 0.5**sweep)
                    _refine(problem, y, x, window, limits, changes, size, planes, cost)


@no_type_check
@njit(**COMPILED)
def _initialize(problem, y, x, window, nearest, farthest, guesses, planes, cost):
    """Start from the plane that is there already, or from random ones."""
    w, p, q = planes[y, x]
    # Disagreement adds to the cost of a match. Twice NO_MATCH is above whatever a plane can cost,
    # so that the first guess is always taken.
    cost[y, x] = _cost(problem, y, x, window, w, p, q) if w > 0 else 2 * NO_MATCH
    for _ in range(guesses):
        w = farthest + (nearest - farthest) * np.float32(np.random.random())
        p = np.float32(np.random.normal())
        q = np.float32(np.random.normal())
        _keep_better(problem, y, x, window, w, p, q, planes, cost)


@no_type_check
@njit(**COMPILED)
def _propagate(problem, y, x, window, limits, mask, back, planes, cost):
    """Try the planes of two neighbours, continued to here."""
    nearest, farthest = limits
    height, width = mask.shape
    # The two that this sweep has been at already, so that a plane can go all the way in one sweep.
    for j, i in ((0, back), (back, 0)):
        if 0 <= y + j < height and 0 <= x + i < width and mask[y + j, x + i]:
            w, p, q = planes[y + j, x + i]
            here = w * (1 - (p * i + q * j) / problem.focal)
            if farthest <= here <= nearest:
                # The slopes are relative to the plane's inverse depth, which is another one here.
                ratio = p * w / here, q * w / here
                _keep_better(problem, y, x, window, here, *ratio, planes, cost)


@no_type_check
@njit(**COMPILED)
def _refine(problem, y, x, window, limits, changes, size, planes, cost):
    """Change a little of everything, at first by up to `size` of the range of inverse depth."""
    nearest, farthest = limits
    for _ in range(changes):
        w, p, q = planes[y, x]
        w += size * (nearest - farthest) * _either_way()
        p += 5 * size * _either_way()
        q += 5 * size * _either_way()
        if farthest <= w <= nearest and abs(p) < MAX_SLOPE and abs(q) < MAX_SLOPE:
            _keep_better(problem, y, x, window, w, p, q, planes, cost)
        size *= np.float32(0.4)


@no_type_check
@njit(**COMPILED)
def _either_way():
    return np.float32(2 * np.random.random() - 1)


@no_type_check
@njit(**COMPILED)
def _keep_better(problem, y, x, window, w, p, q, planes, cost):
    new = _cost(problem, y, x, window, w, p, q)
    if new < cost[y, x]:
        cost[y, x] = new
        planes[y, x, 0], planes[y, x, 1], planes[y, x, 2] = w, p, q


@no_type_check
@njit(**COMPILED)
def _new_window(problem):
    """Make room for a window of P pixels, which all pixels of a view use one after the other.

    Weights (P,), own colours and those of a source (C, P) each, own variance (1,).
    """
    pixels, channels = (2 * problem.reach + 1) ** 2, problem.image.shape[2]
    colors = np.zeros((2, channels, pixels), np.float32)
    return np.zeros(pixels, np.float32), colors[0], colors[1], np.zeros(1, np.float32)


@no_type_check
@njit(**COMPILED)
def _load_window(problem, y, x, window):
    """Fill a window with what surrounds a pixel.

    The weights sum to 1; the colours are taken relative to their mean, times the weights.
    """
    weights, own, _, variance = window
    height, width, channels = problem.image.shape
    side = 2 * problem.reach + 1
    # Pixels outside of the image keep weight 0. Their colours are those of an earlier window, which
    # counts for nothing, as every sum over a window has the weight as a factor.
    weights[:] = 0
    for k in range(len(weights)):
        row = y + (k // side - problem.reach) * problem.stride
        column = x + (k % side - problem.reach) * problem.stride
        if 0 <= row < height and 0 <= column < width:
            unlike = np.float32(0)
            for c in range(channels):
                own[c, k] = problem.image[row, column, c]
                unlike += (own[c, k] - problem.image[y, x, c]) ** 2
            # What has another colour than the middle is likely to lie on another surface.
            weights[k] = 1 / (1 + unlike / np.float32(COLOR_SCALE**2)) ** 2
    # The middle has weight 1, so that the sum is never 0.
    weights /= weights.sum()
    variance[0] = 0
    # Mean, weights and variance of the view's own colours do not depend on the plane: with these
    # done once, each plane that is tried costs one pass over the source.
    for c in range(channels):
        mean = np.float32(0)
        for k in range(len(weights)):
            mean += weights[k] * own[c, k]
        for k in range(len(weights)):
            off = own[c, k] - mean
            own[c, k] = weights[k] * off
            variance[0] += own[c, k] * off


# Compiled without fastmath, which would take it that there are no NaN and no infinities; both mean
# something here.
@no_type_check
@njit(**COMPILED)
def _cost(problem, y, x, window, w, p, q):
    """Return 1 - correlation, and disagreement, with the two best sources on average.

    The two best, because the others may have something in front of the surface.
    """
    least, second = np.float32(NO_MATCH), np.float32(np.inf)
    height, width = problem.image.shape[:2]
    for s in range(len(problem.epipole)):
        z = problem.at_infinity[s, y, x, 2] + w * problem.epipole[s, 2]
        if z <= 0:
            continue
        across = (problem.at_infinity[s, y, x, 0] + w * problem.epipole[s, 0]) / z
        down = (problem.at_infinity[s, y, x, 1] + w * problem.epipole[s, 1]) / z
        if not (0 < across < width and 0 < down < height):
            continue
        _warp_source(problem, s, y, x, window, w, p, q)
        cost = 1 - _correlation(window)
        # w / z is the inverse depth along the axis of the source.
        seen = problem.source_depths[s, int(down), int(across)]
        off = abs(w / z - seen) / problem.gap
        # A source that has found nothing there says nothing. What it has found may be wrong, or
        # stand in front, so that being far off costs no more than a few gaps.
        if not np.isnan(off):
            cost += np.float32(DISAGREEMENT) * min(off, np.float32(MOST_DISAGREEMENT))
        if cost < least:
            least, second = cost, least
        elif cost < second:
            second = cost
    # `second` starts as infinity and becomes NO_MATCH with the first match: at least NO_MATCH, it
    # is no cost of a source that matches.
    return least if second >= NO_MATCH else (least + second) / 2


@no_type_check
@njit(**COMPILED, fastmath=True)
def _warp_source(problem, s, y, x, window, w, p, q):
    """Fill a window with the colours that source s shows of a piece of surface.

    Points outside of the source have the colours of its border.
    """
    weights, _, seen, _ = window
    sources, reach, stride = problem.sources, problem.reach, problem.stride
    _, height, width, channels = sources.shape
    ahead, epipole = problem.at_infinity, problem.epipole
    half = np.float32(0.5)
    k = -1
    for j in range(-reach * stride, reach * stride + 1, stride):
        for i in range(-reach * stride, reach * stride + 1, stride):
            k += 1
            if weights[k] == 0:
                continue
            at = w * (1 + (p * i + q * j) / problem.focal)
            # The middle lies before the source, but a steep plane may pass behind it. Kept before
            # it, such points end up at the border instead of on the opposite side of the image.
            z = 1 / max(ahead[s, y + j, x + i, 2] + at * epipole[s, 2], np.float32(1e-6))
            # Middles of pixels lie at halves, and colours are interpolated between middles.
            u = (ahead[s, y + j, x + i, 0] + at * epipole[s, 0]) * z - half
            v = (ahead[s, y + j, x + i, 1] + at * epipole[s, 1]) * z - half
            u = min(max(u, np.float32(0)), np.float32(width - 1))
            v = min(max(v, np.float32(0)), np.float32(height - 1))
            left, top = int(u), int(v)
            right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
            u -= left
            v -= top
            for c in range(channels):
                upper = sources[s, top, left, c] + u * (
                    sources[s, top, right, c] - sources[s, top, left, c]
                )
                lower = sources[s, bottom, left, c] + u * (
                    sources[s, bottom, right, c] - sources[s, bottom, left, c]
                )
                seen[c, k] = upper + v * (lower - upper)


@no_type_check
@njit(**COMPILED, fastmath=True)
def _correlation(window):
    """Return the correlation of a window's colours, each about its own mean, with a source's."""
    weights, own, seen, variance = window
    squares, common = np.float32(0), np.float32(0)
    for c in range(len(seen)):
        mean = np.float32(0)
        for k in range(len(weights)):
            mean += weights[k] * seen[c, k]
            squares += weights[k] * seen[c, k] ** 2
            common += own[c, k] * seen[c, k]
        # One pass, mean of squares minus square of the mean. Its rounding, 1e-7 of colours in
        # [0, 1], is small against the floor, but may make it negative.
        squares -= mean**2
    floor = np.float32(VARIANCE_FLOOR)
    return common / np.sqrt((variance[0] + floor) * (max(squares, np.float32(0)) + floor))
