"""Distances along rays, and the intervals around them (Mildenhall et al. 2020, section 5.2)."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

PDF_FLOOR = 1e-5
"""Added to every weight, so that every part of a ray is sampled with some probability."""

NEAREST = 1e-3
"""Smallest near distance, as a share of far, of a ray that is sampled evenly in disparity."""


def stratified(
    near: Float[Tensor, " rays"],
    far: Float[Tensor, " rays"],
    count: int,
    spacing: str = "linear",
    generator: torch.Generator | None = None,
) -> Float[Tensor, "rays samples"]:
    """Return one distance in each of `count` equal parts of [near, far].

    Args:
        near: (R,) where sampling begins.
        far: (R,) where it ends.
        count: Number N of samples.
        spacing: Whether the parts are equal in distance ("linear") or in its reciprocal
            ("disparity").
        generator: Draws a position within each part; None: the midpoint of the part.

    Returns:
        (R, N) ascending distances.
    """
    offsets = _offsets((len(near), count), near, generator)
    u = (torch.arange(count, dtype=near.dtype, device=near.device) + offsets) / count
    if spacing == "disparity":
        # A ray may begin at the camera, where the disparity is infinite and all samples would
        # crowd at distance 0.
        inverse_near = 1 / torch.maximum(near, NEAREST * far)[:, None]
        return 1 / torch.lerp(inverse_near, 1 / far[:, None], u)
    return torch.lerp(near[:, None], far[:, None], u)


def edges_between(
    t: Float[Tensor, "rays samples"], near: Float[Tensor, " rays"], far: Float[Tensor, " rays"]
) -> Float[Tensor, "rays edges"]:
    """Return the borders of the intervals around ascending distances.

    Args:
        t: (R, N) ascending distances.
        near: (R,) the first border.
        far: (R,) the last border.

    Returns:
        (R, N+1) borders: halfway between neighbouring distances, near and far at the ends.
    """
    # Halfway, so that intervals depend on the distances alone: coarse and fine samples can then be
    # merged without evaluating the field again, and the intervals cover all of [near, far].
    return torch.cat([near[:, None], (t[:, 1:] + t[:, :-1]) / 2, far[:, None]], dim=1)


def importance(
    t_edges: Float[Tensor, "rays edges"],
    weights: Float[Tensor, "rays samples"],
    count: int,
    generator: torch.Generator | None = None,
    inside: Float[Tensor, "rays samples"] | None = None,
) -> Float[Tensor, "rays count"]:
    """Return distances that are distributed as the weights of intervals.

    Inverse transform sampling, with one distance in each of `count` equal parts of the cumulative
    distribution.

    Args:
        t_edges: (R, N+1) ascending borders of the intervals.
        weights: (R, N) nonnegative weights; they need not add up to 1.
        count: Number of distances per ray.
        generator: Draws a position within each part; None: the midpoint of the part.
        inside: (R, N) 1 for intervals in which there may be distances at all, 0 for others; None:
            there may be in all of them.

    Returns:
        (R, count) ascending distances.
    """
    offsets = _offsets((len(weights), count), weights, generator)
    u = (torch.arange(count, dtype=weights.dtype, device=weights.device) + offsets) / count
    floored = weights + PDF_FLOOR if inside is None else (weights + PDF_FLOOR) * inside
    return _inverse(t_edges, floored, u.expand(len(weights), count).contiguous())[0]


def equal_shares(
    t_edges: Float[Tensor, "rays edges"], weights: Float[Tensor, "rays samples"], count: int
) -> tuple[Float[Tensor, "rays borders"], Int[Tensor, "rays count"]]:
    """Divide rays anew into intervals that have equal shares of the weights.

    Args:
        t_edges: (R, N+1) ascending borders of the old intervals.
        weights: (R, N) nonnegative weights of the old intervals.
        count: Number of new intervals per ray.

    Returns:
        (R, count + 1) borders of the new intervals, from the first edge to the last, and (R, count)
        the index of the old interval in which each new one begins.
    """
    u = torch.linspace(0, 1, count + 1, dtype=weights.dtype, device=weights.device)
    borders, bins = _inverse(
        t_edges, weights + PDF_FLOOR, u.expand(len(weights), count + 1).contiguous()
    )
    # Where the first or last weights are lost in rounding, the shares 0 and 1 do not lie at the
    # ends of the ray, all of which the intervals have to cover.
    borders[:, 0], borders[:, -1] = t_edges[:, 0], t_edges[:, -1]
    return borders, bins[:, :-1]


def merge(
    *distances: Float[Tensor, "rays _"],
) -> tuple[Float[Tensor, "rays samples"], Int[Tensor, "rays samples"]]:
    """Merge sets of distances.

    Args:
        distances: (R, A), (R, B), ...

    Returns:
        (R, A+B+...) all distances in ascending order, and the column of each among the sets one
        behind the other.
    """
    # Stable, so that the order of equal distances is defined on every device.
    t, order = torch.cat(distances, dim=1).sort(dim=1, stable=True)
    return t, order


def _inverse(
    t_edges: Float[Tensor, "rays edges"],
    weights: Float[Tensor, "rays samples"],
    u: Float[Tensor, "rays shares"],
) -> tuple[Float[Tensor, "rays shares"], Int[Tensor, "rays shares"]]:
    """Return the t before which the shares u of a ray's weights lie, and the interval of each."""
    cdf = torch.cumsum(weights, dim=1)
    # Divided by its own last entry, not by a sum of the weights, so that it ends at exactly 1.
    cdf = torch.cat([torch.zeros_like(cdf[:, :1]), cdf], dim=1) / cdf[:, -1:]
    # A share of 1 lies beyond the last entry.
    bins = (torch.searchsorted(cdf, u, right=True) - 1).clamp(0, weights.shape[1] - 1)
    low, high = cdf.gather(1, bins), cdf.gather(1, bins + 1)
    # Beside a large weight the step of the cumulative sum may round to 0; 0 / 0 would then be NaN
    # instead of the beginning of the interval.
    fraction = ((u - low) / (high - low).clamp_min(torch.finfo(cdf.dtype).tiny)).clamp(0, 1)
    return torch.lerp(t_edges.gather(1, bins), t_edges.gather(1, bins + 1), fraction), bins


def _offsets(
    shape: tuple[int, int], like: Tensor, generator: torch.Generator | None
) -> Tensor | float:
    """Return where in its stratum each sample lies, in [0, 1)."""
    if generator is None:
        return 0.5
    # Drawn on the CPU, where the run's generator is, so that the samples are the same on every
    # device.
    return torch.rand(shape, generator=generator, dtype=like.dtype).to(like.device)
