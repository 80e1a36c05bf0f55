from __future__ import annotations

import math

import numpy as np
import pytest
from nerfreg_plugins.stereo.matching import FAINT, NO_MATCH, lower_cost


def images(height=6, width=7, seed=0):
    chance = np.random.default_rng(seed)
    return tuple(chance.random((height, width, 3), dtype=np.float32) for _ in range(2))


def shifted(height, width, right=0.0, down=0.0):
    """Every pixel appears so many pixels further right and down."""
    y, x = np.mgrid[:height, :width]
    return np.stack([x + 0.5 + right, y + 0.5 + down], axis=-1).astype(np.float32)


def one_minus_correlation(a, b):
    """Of two windows (P, C), in double precision: over all colours, each about its own mean."""
    a, b = a.astype(np.float64), b.astype(np.float64)
    a, b = a - a.mean(0), b - b.mean(0)
    count = len(a)
    variances = ((a**2).sum() / count + FAINT) * ((b**2).sum() / count + FAINT)
    return 1 - (a * b).sum() / count / math.sqrt(variances)


def by_definition(own, seen, margin):
    height, width, _ = own.shape
    cost = np.empty((height, width))
    for y in range(height):
        for x in range(width):
            window = (slice(max(y - margin, 0), y + margin + 1), slice(max(x - margin, 0), x + margin + 1))
            cost[y, x] = one_minus_correlation(own[window].reshape(-1, 3), seen[window].reshape(-1, 3))
    return cost


@pytest.mark.parametrize("margin", [0, 1, 2, 9])
def test_against_the_definition(margin):
    own, other = images()
    cost = np.full((6, 7), 9.0, np.float32)
    lower_cost(own, other, shifted(6, 7), margin, cost)
    # The squares of float32 colours are rounded at 1e-7, of FAINT that is 3e-4.
    np.testing.assert_allclose(cost, by_definition(own, other, margin), rtol=1e-4, atol=1e-3)


def test_between_pixels_colours_are_interpolated():
    own, other = images()
    wide = np.concatenate([other, other[:, -1:]], axis=1)
    wide = np.concatenate([wide, wide[-1:]], axis=0)
    # A quarter to the right, half down.
    upper = 0.75 * wide[:-1, :-1] + 0.25 * wide[:-1, 1:]
    lower = 0.75 * wide[1:, :-1] + 0.25 * wide[1:, 1:]
    cost = np.full((6, 7), 9.0, np.float32)
    lower_cost(own, other, shifted(6, 7, 0.25, 0.5), 1, cost)
    expected = by_definition(own, (upper + lower) / 2, 1)
    expected[-1] = 9.0  # half a pixel below the last row's middle is the border, and no longer inside
    np.testing.assert_allclose(cost, expected, rtol=1e-4, atol=1e-5)


def test_the_same_photograph_costs_nothing_and_its_negative_two():
    own, _ = images()
    for other, expected in ((own, 0.0), (1 - own, 2.0)):
        cost = np.full((6, 7), 9.0, np.float32)
        lower_cost(own, other, shifted(6, 7), 2, cost)
        np.testing.assert_allclose(cost, expected, atol=0.02)  # FAINT


def test_costs_are_only_lowered():
    own, other = images()
    cost = np.full((6, 7), -1.0, np.float32)
    lower_cost(own, other, shifted(6, 7), 1, cost)
    assert (cost == -1).all()


@pytest.mark.parametrize("place", [-100.0, 1e9, -1e9, math.inf, -math.inf, math.nan])
def test_outside_nothing_changes(place):
    own, other = images()
    places = np.full((6, 7, 2), place, np.float32)
    cost = np.full((6, 7), NO_MATCH, np.float32)
    lower_cost(own, other, places, 1, cost)
    assert (cost == np.float32(NO_MATCH)).all()


def test_without_texture_there_is_no_correlation():
    flat = np.full((5, 5, 3), 0.7, np.float32)
    cost = np.full((5, 5), 9.0, np.float32)
    lower_cost(flat, flat, shifted(5, 5), 2, cost)
    np.testing.assert_allclose(cost, 1.0, atol=1e-3)
