"""Exact values for `full_geometry_loss`."""

from __future__ import annotations

from collections.abc import Sequence

from mpmath import exp, fsum, mpf


def full_geometry_loss_of_thickness(tau: Sequence[Sequence[mpf]]) -> mpf:
    """Return (1 - sum w)^2 = exp(-2 sum tau), mean over rays.

    Args:
        tau: Optical thickness of the intervals, `(R, N)`.
    """
    return fsum(exp(-2 * fsum(ray)) for ray in tau) / len(tau)
