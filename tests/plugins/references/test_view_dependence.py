from __future__ import annotations

from nerfreg_plugins.references.view_dependence import damped


def test_by_hand(numbers):
    weight = numbers([[1, 2, 3], [4, 5, 6]])
    assert damped(weight, numbers([1, 0.5, 0])) == [[1, 1, 0], [4, 2.5, 0]]
