from __future__ import annotations

import pytest
from nerfreg_plugins.references.annealing import annealed_bounds


@pytest.mark.parametrize(
    ("eta", "mid", "expected"),
    [(0.5, 0.5, ([3], [5])), (0.5, 0, ([2], [4])), (0.5, 1, ([4], [6])), (1, 0.25, ([2], [6]))],
)
def test_by_hand(numbers, eta, mid, expected):
    # From 2 to 6, with the middle at 4, 2, 6 and 3.
    bounds = annealed_bounds(numbers([2]), numbers([6]), numbers(eta), numbers(mid))
    assert bounds == expected
