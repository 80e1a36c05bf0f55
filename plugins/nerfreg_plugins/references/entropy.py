"""Exact values for `entropy`."""

from __future__ import annotations

from collections.abc import Sequence

from mpmath import fsum, log, mpf


def entropy_loss(alphas: Sequence[Sequence[mpf]], threshold: mpf | float) -> mpf:
    """Return -sum q log q with q = alpha / sum alpha, mean over rays.

    Args:
        alphas: `(R, N)`.
        threshold: Rays whose alphas sum to no more than this count as 0.
    """
    return fsum(_of_ray(ray, threshold) for ray in alphas) / len(alphas)


def _of_ray(alphas: Sequence[mpf], threshold: mpf | float) -> mpf:
    total = fsum(alphas)
    if total <= threshold:
        return mpf(0)
    return -fsum(a / total * log(a / total) for a in alphas if a > 0)
