"""Surfaces before two cameras side by side.

What is at inverse depth w appears focal * w pixels further left in the second.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from nerfreg_plugins.stereo.patch_match import (
    COLOR_SCALE,
    DISAGREEMENT,
    MOST_DISAGREEMENT,
    NO_MATCH,
    VARIANCE_FLOOR,
    MatchingProblem,
    _cost,
    _load_window,
    _new_window,
    patch_match,
)

HEIGHT, WIDTH, FOCAL = 20, 24, 40.0
NEAREST, FARTHEST = np.float32(0.2), np.float32(0.02)


def noise(seed=0, channels=3):
    """Colours that are alike from pixel to pixel, so that they can be interpolated."""
    rough = np.random.default_rng(seed).random((HEIGHT + 2, WIDTH + 2, channels))
    rough = (rough[1:] + rough[:-1]) / 2
    return ((rough[:-1, 1:] + rough[:-1, :-1]) / 2)[:HEIGHT, :WIDTH].astype(np.float32)


def comparison(own, others, baselines=(1.0,), believed=math.nan, reach=1, step=2):
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    ahead = np.stack([x, y, np.ones_like(x)], -1).astype(np.float32)
    return MatchingProblem(
        own,
        np.stack(others),
        np.stack([ahead] * len(others)),
        np.array([[-FOCAL * baseline, 0, 0] for baseline in baselines], np.float32),
        np.full((len(others), HEIGHT, WIDTH), believed, np.float32),
        np.float32(0.001),
        np.float32(FOCAL),
        reach,
        step,
    )


def cost(views, y, x, w, p=0.0, q=0.0):
    window = _new_window(views)
    _load_window(views, y, x, window)
    return _cost(views, y, x, window, *map(np.float32, (w, p, q)))


def seen(image, x, y):
    """Interpolated at (x, y) in pixels; the border's colour outside."""
    x, y = min(max(x - 0.5, 0), WIDTH - 1), min(max(y - 0.5, 0), HEIGHT - 1)
    left, top = int(x), int(y)
    right, bottom = min(left + 1, WIDTH - 1), min(top + 1, HEIGHT - 1)
    u, v = x - left, y - top
    image = image.astype(np.float64)
    return (1 - v) * ((1 - u) * image[top, left] + u * image[top, right]) + v * (
        (1 - u) * image[bottom, left] + u * image[bottom, right]
    )


def by_definition(own, other, y, x, w, p, q, reach, step):
    """1 - correlation of a window, pixels like its middle counting more, in float64."""
    weights, mine, theirs = [], [], []
    for j in range(-reach * step, reach * step + 1, step):
        for i in range(-reach * step, reach * step + 1, step):
            if 0 <= x + i < WIDTH and 0 <= y + j < HEIGHT:
                color = own[y + j, x + i].astype(np.float64)
                unlike = ((color - own[y, x]) ** 2).sum()
                weights.append(1 / (1 + unlike / COLOR_SCALE**2) ** 2)
                mine.append(color)
                here = w * (1 + (p * i + q * j) / FOCAL)
                theirs.append(seen(other, x + i + 0.5 - FOCAL * here, y + j + 0.5))
    weights, mine, theirs = (
        np.array(weights)[:, None] / sum(weights),
        np.array(mine),
        np.array(theirs),
    )
    mine, theirs = mine - (weights * mine).sum(0), theirs - (weights * theirs).sum(0)
    variances = ((weights * mine**2).sum() + VARIANCE_FLOOR) * (
        (weights * theirs**2).sum() + VARIANCE_FLOOR
    )
    return 1 - (weights * mine * theirs).sum() / math.sqrt(variances)


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize(
    "y, x, w, p, q", [(9, 12, 0.1, 0, 0), (9, 12, 0.123, 1.5, -0.7), (0, 23, 0.05, -1, 2)]
)
@pytest.mark.parametrize("reach, step", [(0, 2), (1, 1), (2, 2)])
def test_cost_against_the_definition(channels, y, x, w, p, q, reach, step):
    own, other = noise(0, channels), noise(1, channels)
    views = comparison(own, [other], reach=reach, step=step)
    expected = by_definition(own, other, y, x, w, p, q, reach, step)
    # The squares of float32 colours are rounded at 1e-7, of VARIANCE_FLOOR that is 3e-4.
    assert cost(views, y, x, w, p, q) == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_the_two_best_sources_count():
    own = noise()
    same, negative, other = own, 1 - own, noise(1)
    alone = [
        float(cost(comparison(own, [source], (0.0,)), 9, 12, 0.1))
        for source in (same, negative, other)
    ]
    assert alone[0] == pytest.approx(0, abs=0.1) and alone[1] == pytest.approx(
        2, abs=0.1
    )  # VARIANCE_FLOOR
    together = cost(comparison(own, [negative, same, other], (0.0, 0.0, 0.0)), 9, 12, 0.1)
    assert together == pytest.approx((alone[0] + alone[2]) / 2)


@pytest.mark.parametrize("baseline", [100.0, -100.0])
def test_a_source_that_does_not_see_the_place_says_nothing(baseline):
    own = noise()
    assert cost(comparison(own, [own], (baseline,)), 9, 12, 0.1) == NO_MATCH
    alone = cost(comparison(own, [noise(1)], (0.0,)), 9, 12, 0.1)
    assert cost(comparison(own, [noise(1), own], (0.0, baseline)), 9, 12, 0.1) == alone


def test_behind_a_source_is_nothing():
    own = noise()
    views = comparison(own, [own], (0.0,))
    views.epipole[0] = -20 * views.at_infinity[0, 9, 12]
    assert cost(views, 9, 12, 0.04) != NO_MATCH
    assert cost(views, 9, 12, 0.06) == NO_MATCH


@pytest.mark.parametrize(
    "gaps, doubted", [(0, 0), (1.5, 1.5), (-2, 2), (30, MOST_DISAGREEMENT), (math.nan, 0)]
)
def test_it_costs_to_be_elsewhere_than_a_source_believes(gaps, doubted):
    own, other = noise(), noise(1)
    unasked = cost(comparison(own, [other]), 9, 12, 0.1)
    asked = cost(comparison(own, [other], believed=0.1 + 0.001 * gaps), 9, 12, 0.1)
    assert asked - unasked == pytest.approx(DISAGREEMENT * doubted, abs=1e-4)


def test_without_texture_there_is_no_correlation():
    flat = np.full((HEIGHT, WIDTH, 3), 0.7, np.float32)
    assert cost(comparison(flat, [flat], reach=2), 9, 12, 0.1) == pytest.approx(1, abs=1e-2)


def slanted(slope):
    """Two images of a surface at inverse depth 0.1 (1 + slope (x - 12) / FOCAL).

    The second camera is one unit further right.
    """
    own = noise()
    other = np.zeros_like(own)
    for x in range(WIDTH):
        # x' = x - 4 (1 + slope (x - 12) / 40) solved for x; pixel middles are at + 0.5
        source = (x + 0.5 + 4 - 4 * slope * 12.5 / FOCAL) / (1 - 4 * slope / FOCAL)
        for y in range(HEIGHT):
            other[y, x] = seen(own, source, y + 0.5)
    return own, other


def found(own, other, seed=0, **more):
    views = comparison(own, [other], reach=2)
    planes, costs = (
        np.zeros((HEIGHT, WIDTH, 3), np.float32),
        np.full((HEIGHT, WIDTH), NO_MATCH, np.float32),
    )
    there = more.pop("there", np.ones((HEIGHT, WIDTH), bool))
    arguments = {"guesses": 6, "sweeps": 4, "changes": 3} | more
    patch_match(views, there, NEAREST, FARTHEST, *arguments.values(), seed, planes, costs)
    return views, planes, costs


@pytest.mark.parametrize("slope", [0.0, 1.5, -1.5])
def test_a_slanted_surface_is_found_with_its_slope(slope):
    _, planes, _ = found(*slanted(slope))
    x = np.arange(8, 20)
    truth = 0.1 * (1 + slope * (x - 12) / FOCAL)
    inner = planes[4:-4, 8:20]
    # A tenth of a pixel is 0.0025 of inverse depth.
    assert np.median(np.abs(inner[..., 0] - truth)) < 0.0025
    assert np.median(inner[..., 1]) == pytest.approx(slope, abs=0.7)
    assert np.median(inner[..., 2]) == pytest.approx(0, abs=0.7)


def test_searching_on_never_makes_it_worse():
    views, planes, costs = found(*slanted(1.0), sweeps=1)
    before = costs.copy()
    patch_match(views, np.ones((HEIGHT, WIDTH), bool), NEAREST, FARTHEST, 0, 2, 2, 1, planes, costs)
    assert (costs <= before + 1e-5).all() and costs.mean() < before.mean() - 1e-3  # rounding
    assert (planes[..., 0] >= FARTHEST).all() and (planes[..., 0] <= NEAREST).all()


def test_costs_belong_to_their_planes():
    views, planes, costs = found(*slanted(1.0))
    for y, x in ((0, 0), (9, 12), (HEIGHT - 1, WIDTH - 1)):
        assert cost(views, y, x, *planes[y, x]) == pytest.approx(costs[y, x], abs=1e-5)


def test_the_same_seed_finds_the_same():
    first, second, other = (found(*slanted(1.0), seed=seed)[1] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, second)
    assert (first != other).any()


def test_nothing_is_searched_where_nothing_is():
    there = np.zeros((HEIGHT, WIDTH), bool)
    there[5:10, 5:10] = True
    _, planes, costs = found(*slanted(0.0), there=there)
    assert (planes[~there] == 0).all() and (costs[~there] == NO_MATCH).all()
    assert (planes[there][:, 0] > 0).all()
