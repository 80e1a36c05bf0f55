from __future__ import annotations

import mpmath
from nerfreg_plugins.references.unseen_smoothness import unseen_smoothness_loss


def test_by_hand(numbers, close):
    # 1 2 / 2 8: right log 2 and log 4, down log 2 and log 4. The flat patch adds 0.
    patches = numbers([[[1, 2], [2, 8]], [[3, 3], [3, 3]]])
    seen = [[[True, True], [True, True]]] * 2
    assert close(unseen_smoothness_loss(patches, seen), 10 * mpmath.log(2) ** 2 / 2)


def test_hidden_pixels_and_depths_of_0_are_left_out(numbers, close):
    # What is left is 1 2 in the upper row, or 1 and 2 in the left column.
    without_below = unseen_smoothness_loss(
        numbers([[[1, 2], [5, 8]]]), [[[True, True], [False, False]]]
    )
    without_right = unseen_smoothness_loss(
        numbers([[[1, 0], [2, 0]]]), [[[True, True], [True, True]]]
    )
    assert close(without_below, mpmath.log(2) ** 2) and close(without_right, mpmath.log(2) ** 2)
    assert unseen_smoothness_loss([], []) == 0
