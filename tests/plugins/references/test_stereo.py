from __future__ import annotations

import mpmath
import pytest
from nerfreg_plugins.references.stereo import stereo_loss

NAN = float("nan")


@pytest.mark.parametrize(
    ("edges", "known", "expected"),
    [
        # Half of the light stays in each interval: weights 1/2, 1/4, and 1/4 passes. All of the
        # second interval counts, and half of the first, which is half an extent away: m = 1/2.
        ([0, 1, 2], [1.5, 2.5], "3/2"),
        # The first interval alone, the second being twice half the extent away: 1/2 + 1/5 * 1/4.
        ([0, 1.25, 2], [0.25, 0.75], "10/7"),
        ([0, 1, 2], [NAN, NAN], "1"),
        ([0, 1, 2], [2.5, 3.5], "1"),  # beyond the last interval
    ],
)
def test_by_hand(numbers, close, edges, known, expected):
    log2 = mpmath.log(2)
    value = stereo_loss(
        numbers([[0.5, 0.25]]), numbers([edges]), numbers([known]), numbers(0.5), [[log2, log2]]
    )
    assert close(value, mpmath.log(numbers(expected)))
