"""Exact values for `annealing`."""

from __future__ import annotations

from collections.abc import Sequence

from mpmath import mpf


def annealed_bounds(
    near: Sequence[mpf], far: Sequence[mpf], eta: mpf, mid: mpf
) -> tuple[list[mpf], list[mpf]]:
    """Return t_m + (t_n - t_m) eta and t_m + (t_f - t_m) eta of each ray.

    Args:
        near: t_n of each ray, `(R,)`.
        far: t_f of each ray, `(R,)`.
        eta: Share of the ray that is sampled.
        mid: Where t_m lies between near (0) and far (1).
    """
    middles = [n + mid * (f - n) for n, f in zip(near, far, strict=True)]
    return (
        [m + (n - m) * eta for n, m in zip(near, middles, strict=True)],
        [m + (f - m) * eta for f, m in zip(far, middles, strict=True)],
    )
