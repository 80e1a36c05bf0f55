from __future__ import annotations

from mpmath import exp
from nerfreg_plugins.references.convex_prior import outside_opacity


def test_by_hand(numbers, close):
    tau = numbers([[1, 2, 0], [3, 0.5, 1]])
    outside = [[True, False, True], [False, True, True]]
    expected = (3 - exp(-1) - exp(-numbers(0.5)) - exp(-1)) / 2
    assert close(outside_opacity(tau, outside), expected)


def test_nothing_outside(numbers):
    assert outside_opacity(numbers([[1, 2]]), [[False, False]]) == 0
