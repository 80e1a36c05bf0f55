from __future__ import annotations

import mpmath
from nerfreg_plugins.references.entropy import entropy_loss


def test_by_hand(numbers, close):
    # q = (1/2, 1/4, 1/4): 1/2 log 2 + 2 * 1/4 * log 4. One sample with everything has none.
    alphas = numbers([[0.5, 0.25, 0.25], [0, 1, 0]])
    assert close(entropy_loss(alphas, 0.1), 0.75 * mpmath.log(2))


def test_faint_rays_are_0(numbers):
    assert entropy_loss(numbers([[0.25, 0.25]]), 0.5) == 0
