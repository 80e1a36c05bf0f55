"""Exact values for `occlusion_loss`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from mpmath import fsum, mpf


def occlusion_loss(
    penalised: Sequence[Sequence[mpf]],
    t_edges: Sequence[Sequence[mpf]],
    near: Sequence[mpf],
    far: Sequence[mpf],
    fraction: mpf,
) -> mpf:
    """Return the mean over the samples in the first `fraction` of [near, far], mean over rays.

    Args:
        penalised: Weights or densities, `(R, N)`.
        t_edges: Interval borders, `(R, N+1)`.
        near: Where each ray begins, `(R,)`.
        far: Where it ends, `(R,)`.
        fraction: Share of the ray that should be empty.
    """
    rays = zip(penalised, t_edges, near, far, strict=True)
    return fsum(_of_ray(*ray, fraction) for ray in rays) / len(penalised)


def _of_ray(
    penalised: Sequence[mpf], t_edges: Sequence[mpf], near: mpf, far: mpf, fraction: mpf
) -> mpf:
    border = near + fraction * (far - near)
    middles = [(low + high) / 2 for low, high in pairwise(t_edges)]
    close = [value for value, middle in zip(penalised, middles, strict=True) if middle < border]
    return fsum(close) / max(len(close), 1)
