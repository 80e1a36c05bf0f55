from __future__ import annotations

import pytest
from nerfreg_plugins.references.occlusion import occlusion_loss


@pytest.mark.parametrize(
    ("fraction", "expected"),
    # Midpoints 2.5, 3.5, 4.5 and 5.5 between 2 and 6.
    [(0, 0), (0.125, 0), (0.25, 0.5), (0.5, 0.375), (1, 0.25)],
)
def test_by_hand(numbers, fraction, expected):
    weights, edges = numbers([[0.5, 0.25, 0.25, 0]]), numbers([[2, 3, 4, 5, 6]])
    value = occlusion_loss(weights, edges, numbers([2]), numbers([6]), numbers(fraction))
    assert value == expected
