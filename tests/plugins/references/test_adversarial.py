from __future__ import annotations

from nerfreg_plugins.references.adversarial import mean_squared_error


def test_by_hand(numbers):
    # Differences 1/2, 0, 1 and 0, 0, -1/2: squares add up to 3/2.
    colors, targets = numbers([[0.5, 1, 1], [0, 0, 0]]), numbers([[0, 1, 0], [0, 0, 0.5]])
    assert mean_squared_error(colors, targets) == numbers("1/4")
