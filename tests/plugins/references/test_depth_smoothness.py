from __future__ import annotations

import pytest
from nerfreg_plugins.references.depth_smoothness import depth_smoothness_loss


@pytest.mark.parametrize(
    ("hidden", "opacity", "expected"),
    [
        # Only the upper left pixel has neighbours on both sides: (1 - 3)^2 + (1 - 4)^2.
        (None, None, 13),
        (None, 0.5, 6.5),
        ((0, 1), None, 9),  # the right neighbour
        ((1, 0), None, 4),  # the one below
        ((0, 0), None, 0),
    ],
)
def test_by_hand(numbers, hidden, opacity, expected):
    visible = [[[(i, j) != hidden for j in range(2)] for i in range(2)]]
    weights = None if opacity is None else numbers([[[opacity, 9], [9, 9]]])
    patches = numbers([[[1, 3], [4, 100]]])
    assert depth_smoothness_loss(patches, visible, weights) == expected


def test_mean_over_patches(numbers):
    # Steps of 1 to the right at the 4 pixels that have neighbours on both sides, and a flat patch.
    steps, flat = [[0, 1, 2]] * 3, [[5] * 3] * 3
    visible = [[[True] * 3] * 3] * 2
    assert depth_smoothness_loss(numbers([steps, flat]), visible) == 2
    assert depth_smoothness_loss([], []) == 0
    assert depth_smoothness_loss(numbers([[[1]]]), [[[True]]]) == 0
