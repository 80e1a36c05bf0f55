"""Exact values for `adversarial`."""

from __future__ import annotations

from collections.abc import Sequence

from mpmath import fsum, mpf


def mean_squared_error(colors: Sequence[Sequence[mpf]], targets: Sequence[Sequence[mpf]]) -> mpf:
    """Return the mean of (color - target)^2 over all channels of all rays.

    Args:
        colors: Rendered colours, `(S, 3)`.
        targets: Colours of the photographs, `(S, 3)`.
    """
    squares = [
        (color - target) ** 2
        for ray in zip(colors, targets, strict=True)
        for color, target in zip(*ray, strict=True)
    ]
    return fsum(squares) / len(squares)
