"""Exact values for `lipschitz`."""

from __future__ import annotations

from collections.abc import Sequence

from mpmath import exp, fsum, log1p, mpf


def softplus(k: mpf) -> mpf:
    """Return log(1 + exp(k))."""
    return log1p(exp(k))


def normalize_rows(weight: Sequence[Sequence[mpf]], k: mpf) -> list[list[mpf]]:
    """Return the rows of W scaled by min(1, softplus(k) / sum abs(row)).

    Args:
        weight: W, `(out, in)`.
        k: The layer's trainable parameter.
    """
    bound = softplus(k)
    sums = [fsum(map(abs, row)) for row in weight]
    scales = [bound / total if total > bound else mpf(1) for total in sums]
    return [[scale * w for w in row] for scale, row in zip(scales, weight, strict=True)]
