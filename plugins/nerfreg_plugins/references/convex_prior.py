"""Exact values for `outside_opacity`."""

from __future__ import annotations

from collections.abc import Sequence

from mpmath import expm1, fsum, mpf


def outside_opacity(tau: Sequence[Sequence[mpf]], outside: Sequence[Sequence[bool]]) -> mpf:
    """Return the sum of the opacities 1 - exp(-tau) of samples outside, mean over rays.

    Args:
        tau: Optical thickness of the intervals, `(R, N)`.
        outside: Which samples lie outside, `(R, N)`.
    """
    of_rays = (
        -expm1(-thickness)
        for row, beyond in zip(tau, outside, strict=True)
        for thickness, out in zip(row, beyond, strict=True)
        if out
    )
    return fsum(of_rays) / len(tau)
