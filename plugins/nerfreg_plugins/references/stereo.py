"""Exact values for `stereo`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from mpmath import exp, fsum, isnan, log1p, mpf


def stereo_loss(
    weights: Sequence[Sequence[mpf]],
    t_edges: Sequence[Sequence[mpf]],
    known_depth: Sequence[Sequence[mpf]],
    doubt: mpf,
    tau: Sequence[Sequence[mpf]],
) -> mpf:
    """Return log((1 + doubt) / (m + doubt)), mean over rays.

    Args:
        weights: `(R, N)`.
        t_edges: Interval borders, `(R, N+1)`.
        known_depth: First and last distance of a known surface, `(R, 2)`; NaN where unknown.
        doubt: How likely it is that what is known is wrong.
        tau: Optical thickness of the intervals, `(R, N)`.
    """
    rays = zip(weights, tau, t_edges, known_depth, strict=True)
    return fsum(_of_ray(*ray, doubt) for ray in rays) / max(len(weights), 1)


def _of_ray(
    weights: Sequence[mpf],
    tau: Sequence[mpf],
    t_edges: Sequence[mpf],
    known: Sequence[mpf],
    doubt: mpf,
) -> mpf:
    first, last = known
    if isnan(first) or isnan(last):
        return mpf(0)
    half = (last - first) / 2
    off = [max(first - end, begin - last, mpf(0)) for begin, end in pairwise(t_edges)]
    if 0 not in off:
        return mpf(0)
    trust = [mpf(1) if x == 0 else half**2 / (half**2 + x**2) for x in off]
    there = fsum(w * t for w, t in zip(weights, trust, strict=True))
    elsewhere = fsum(w * (1 - t) for w, t in zip(weights, trust, strict=True))
    return log1p((elsewhere + exp(-fsum(tau))) / (there + doubt))
