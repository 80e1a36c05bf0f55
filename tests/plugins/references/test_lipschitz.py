from __future__ import annotations

import mpmath
from nerfreg_plugins.references.lipschitz import normalize_rows, softplus


def test_by_hand(numbers, close):
    # softplus(log 3) = log 4: the first row, which sums to 2 log 4, is halved; the others stay.
    k, bound = mpmath.log(3), mpmath.log(4)
    assert close(softplus(k), bound)
    [[a, b], *kept] = normalize_rows([[bound, -bound], *numbers([[0.5, -0.5], [0, 0]])], k)
    assert close(a, bound / 2) and close(b, -bound / 2)
    assert kept == [[0.5, -0.5], [0, 0]]
