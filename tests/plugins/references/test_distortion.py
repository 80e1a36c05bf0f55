from __future__ import annotations

import itertools

from nerfreg_plugins.references.distortion import distortion_loss


def test_by_hand(numbers, close):
    # Midpoints 1/2 and 2, lengths 1 and 2: 2 * 1/2 * 1/4 * 3/2 + (1/4 + 2/16) / 3 = 1/2.
    weights, edges = numbers([[0.5, 0.25]]), numbers([[0, 1, 3]])
    assert close(distortion_loss(weights, edges, numbers([2])), 0.25)


def test_pair_by_pair(numbers, close):
    weights, edges = numbers([0.125, 0.5, 0.0625, 0.25]), numbers([1, 1.5, 4, 7, 7.25])
    middles = [(a + b) / 2 for a, b in itertools.pairwise(edges)]
    lengths = [b - a for a, b in itertools.pairwise(edges)]
    places = list(zip(weights, middles, strict=True))
    pairs = sum(w * v * abs(m - n) for w, m in places for v, n in places)
    inside = sum(w**2 * length for w, length in zip(weights, lengths, strict=True)) / 3
    assert close(distortion_loss([weights], [edges], numbers([3])), (pairs + inside) / 3)


def test_rays_that_do_not_count_still_count_in_the_mean(numbers, close):
    weights = numbers([[0.5, 0.25], [2e-5, 2e-5], [0.5, 0.25]])
    edges = numbers([[0, 1, 3]] * 3)
    assert close(distortion_loss(weights, edges, numbers([2, 2, 0])), numbers("1/12"))
