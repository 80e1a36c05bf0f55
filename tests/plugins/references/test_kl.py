from __future__ import annotations

import mpmath
from nerfreg_plugins.references.kl import kl_loss_of_logs


def test_by_hand(close):
    # p = (1/2, 1/2, 0), q = (1/4, 1/2, 1/4): 1/2 log 2. A common factor changes nothing.
    minus_infinity, log2 = mpmath.mpf("-inf"), mpmath.log(2)
    ray = [log2 - 2000, log2 - 2000, minus_infinity]
    neighbor = [mpmath.mpf(0), log2, mpmath.mpf(0)]
    assert close(kl_loss_of_logs([ray], [neighbor]), log2 / 2)


def test_floor_empty_rays_and_no_pairs(numbers, close):
    one, other, empty = numbers(["0", "-inf"]), numbers(["-inf", "0"]), numbers(["-inf", "-inf"])
    at_floor = -mpmath.log(mpmath.mpf(1e-10))
    assert close(kl_loss_of_logs([one, one, empty], [other, empty, one]), at_floor / 3)
    assert kl_loss_of_logs([], []) == 0
