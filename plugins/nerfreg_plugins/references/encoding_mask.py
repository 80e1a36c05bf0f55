"""Exact values for `encoding_mask`."""

from __future__ import annotations

from mpmath import floor, mpf


def fractional_features(count: int, ratio: mpf) -> mpf:
    """Return count * ratio, how many features a ratio in [0, 1] keeps."""
    return count * ratio


def whole_features(count: int, ratio: mpf) -> mpf:
    """Return floor(count * ratio), how many whole features a ratio in [0, 1] keeps."""
    return floor(count * ratio)
