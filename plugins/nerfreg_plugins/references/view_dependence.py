"""Exact values for `view_dependence`."""

from __future__ import annotations

from collections.abc import Sequence

from mpmath import mpf


def damped(weight: Sequence[Sequence[mpf]], factors: Sequence[mpf]) -> list[list[mpf]]:
    """Return a weight matrix whose columns are multiplied by factors.

    Args:
        weight: `(out, in)`.
        factors: Of each input, `(in,)`.
    """
    return [[w * factor for w, factor in zip(row, factors, strict=True)] for row in weight]
