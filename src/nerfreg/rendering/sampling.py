"""Distances along rays: stratified, by importance, and the intervals around them (Mildenhall et al. 2020, 5.2)."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

PDF_FLOOR = 1e-5
"""Added to every weight, so that no part of a ray is never looked at."""

NEAREST = 1e-3
"""A ray that is sampled evenly in disparity begins at this share of its far end, where it would begin at 0."""


def stratified(
    near: Float[Tensor, " rays"],
    far: Float[Tensor, " rays"],
    count: int,
    spacing: str = "linear",
    generator: torch.Generator | None = None,
) -> Float[Tensor, "rays samples"]:
    """One distance in each of `count` equal parts of [near, far], ascending, (R, count).

    spacing: equal in distance ("linear") or in its reciprocal ("disparity"). Without a generator the parts' midpoints.
    """
    offsets = _offsets((len(near), count), near, generator)
    u = (torch.arange(count, dtype=near.dtype, device=near.device) + offsets) / count
    if spacing == "disparity":
        return 1 / torch.lerp(1 / torch.maximum(near, NEAREST * far)[:, None], 1 / far[:, None], u)
    return torch.lerp(near[:, None], far[:, None], u)


def edges_between(
    t: Float[Tensor, "rays samples"], near: Float[Tensor, " rays"], far: Float[Tensor, " rays"]
) -> Float[Tensor, "rays edges"]:
    """Borders of the intervals that belong to ascending distances: halfway between them, near and far at the ends."""
    return torch.cat([near[:, None], (t[:, 1:] + t[:, :-1]) / 2, far[:, None]], dim=1)


def importance(
    t_edges: Float[Tensor, "rays edges"],
    weights: Float[Tensor, "rays samples"],
    count: int,
    generator: torch.Generator | None = None,
) -> Float[Tensor, "rays count"]:
    """Distances distributed as the weights of the intervals, ascending, (R, count): inverse transform sampling.

    One distance in each of `count` equal parts of the cumulative distribution; their midpoints without a generator.
    """
    offsets = _offsets((len(weights), count), weights, generator)
    u = (torch.arange(count, dtype=weights.dtype, device=weights.device) + offsets) / count
    return _inverse(t_edges, weights, u.expand(len(weights), count).contiguous())[0]


def equal_shares(
    t_edges: Float[Tensor, "rays edges"], weights: Float[Tensor, "rays samples"], count: int
) -> tuple[Float[Tensor, "rays borders"], Int[Tensor, "rays count"]]:
    """Borders (R, count + 1) of `count` intervals with equal shares of the weights, from the first edge to the last.

    Also, (R, count), the old interval in which each new one begins.
    """
    u = torch.linspace(0, 1, count + 1, dtype=weights.dtype, device=weights.device)
    borders, bins = _inverse(t_edges, weights, u.expand(len(weights), count + 1).contiguous())
    borders[:, 0], borders[:, -1] = t_edges[:, 0], t_edges[:, -1]
    return borders, bins[:, :-1]


def _inverse(
    t_edges: Float[Tensor, "rays edges"],
    weights: Float[Tensor, "rays samples"],
    u: Float[Tensor, "rays shares"],
) -> tuple[Float[Tensor, "rays shares"], Int[Tensor, "rays shares"]]:
    """Where shares u of the weights of a ray lie before t, and in which interval that is."""
    cdf = torch.cumsum(weights + PDF_FLOOR, dim=1)
    cdf = torch.cat([torch.zeros_like(cdf[:, :1]), cdf], dim=1) / cdf[:, -1:]
    bins = (torch.searchsorted(cdf, u, right=True) - 1).clamp(0, weights.shape[1] - 1)
    low, high = cdf.gather(1, bins), cdf.gather(1, bins + 1)
    fraction = ((u - low) / (high - low).clamp_min(torch.finfo(cdf.dtype).tiny)).clamp(0, 1)
    return torch.lerp(t_edges.gather(1, bins), t_edges.gather(1, bins + 1), fraction), bins


def merge(
    first: Float[Tensor, "rays a"], second: Float[Tensor, "rays b"]
) -> tuple[Float[Tensor, "rays samples"], Int[Tensor, "rays samples"]]:
    """Both sets of distances in ascending order, and for each its place in `cat([first, second], dim=1)`."""
    t, order = torch.cat([first, second], dim=1).sort(dim=1, stable=True)
    return t, order


def _offsets(
    shape: tuple[int, int], like: Tensor, generator: torch.Generator | None
) -> Tensor | float:
    """Where in its stratum each sample lies, [0, 1)."""
    if generator is None:
        return 0.5
    return torch.rand(shape, generator=generator, dtype=like.dtype).to(like.device)
