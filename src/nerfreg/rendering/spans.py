"""The parts of rays that may hold matter, and samples by their length.

Where plugins declare space empty, a ray is a row of spans with gaps between them. Samples are
spread over the spans alone, and each gap becomes an interval of its own, of density 0, in which
nothing is evaluated. So the borders of intervals ascend from the first span to the last as they do
on other rays, every length is that of its interval, and what plugins compute of a rendering needs
to know nothing of gaps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from nerfreg.rays.traversal import Runs
from nerfreg.rendering.sampling import NEAREST, edges_between, merge, stratified

MOST_SPANS = 8
"""Spans of a ray; the smallest gaps of a ray with more of them are filled."""


@dataclass(frozen=True)
class Spans:
    """Where R rays, or groups of rays, are sampled: K spans each.

    Rays with fewer spans have spans without length at their ends. A ray that meets nothing has one
    from near to far: what is empty there is not evaluated anyway.

    Attributes:
        begin: (R, K) where each span begins, ascending.
        end: (R, K) where it ends.
    """

    begin: Float[Tensor, "rays spans"]
    end: Float[Tensor, "rays spans"]

    @classmethod
    def whole(cls, near: Float[Tensor, " rays"], far: Float[Tensor, " rays"]) -> Spans:
        """Return rays that are sampled from near to far."""
        return cls(near[:, None], far[:, None])

    @classmethod
    def of(
        cls,
        runs: Runs,
        groups: Int[Tensor, " rays"] | None,
        near: Float[Tensor, " groups"],
        far: Float[Tensor, " groups"],
        most: int = MOST_SPANS,
    ) -> Spans:
        """Return the union of runs over the rays of each group.

        Args:
            runs: Parts of rays.
            groups: (R,) the group of each ray; None: each ray is one.
            near: (G,) where groups begin.
            far: (G,) where they end.
            most: How many spans a group may have.
        """
        if groups is not None:
            runs = _united(runs._replace(ray=groups[runs.ray]))
        count = torch.bincount(runs.ray, minlength=len(near))
        begin, end = _rows(runs, count)
        if begin.shape[1] > most:
            begin, end, count = _filled(begin, end, count, most)
        # Rays with fewer spans end where their last one does, and those without any are whole.
        index = torch.arange(begin.shape[1], device=near.device)
        last = end.gather(1, (count[:, None] - 1).clamp_min(0))
        missing = index >= count[:, None]
        begin, end = torch.where(missing, last, begin), torch.where(missing, last, end)
        nothing = (count == 0)[:, None]
        first = index == 0
        begin = torch.where(nothing, torch.where(first, near[:, None], far[:, None]), begin)
        return cls(begin, torch.where(nothing, far[:, None], end))

    @property
    def near(self) -> Float[Tensor, " rays"]:
        """(R,) where the first span begins."""
        return self.begin[:, 0]

    @property
    def far(self) -> Float[Tensor, " rays"]:
        """(R,) where the last span ends."""
        return self.end[:, -1]

    @cached_property
    def gaps(self) -> Float[Tensor, "rays gaps"]:
        """(R, K-1) the middle of the gap behind each span but the last."""
        return (self.end[:, :-1] + self.begin[:, 1:]) / 2

    def per_ray(self, groups: Int[Tensor, " rays"] | None) -> Spans:
        """Return the spans of the rays that belong to these groups; itself for None."""
        return self if groups is None else Spans(self.begin[groups], self.end[groups])

    def stratified(
        self, count: int, spacing: str = "linear", generator: torch.Generator | None = None
    ) -> Float[Tensor, "rays samples"]:
        """Return ascending distances in the spans, at least one in each.

        Beyond that, spans get samples by their lengths: the ray's is divided into about equal
        parts, and a random distance is taken in each.

        Args:
            count: Number N of samples, not less than the spans of a ray.
            spacing: Whether parts are equal in distance ("linear") or in its reciprocal
                ("disparity").
            generator: Draws a position within each part; None: the midpoint of the part.

        Returns:
            (R, N) distances.
        """
        spans = self.begin.shape[1]
        if spans == 1:
            return stratified(self.near, self.far, count, spacing, generator)
        begin, end = self.begin, self.end
        if spacing == "disparity":
            # As where there are no gaps: a ray may begin at the camera, or even end there.
            least = (NEAREST * self.far[:, None]).clamp_min(torch.finfo(begin.dtype).tiny)
            begin, end = -1 / begin.maximum(least), -1 / end.maximum(least)
        length = (end - begin).clamp_min(0)
        real = (self.end > self.begin).to(length.dtype)
        # Rays that miss the box have no length at all.
        total = length.sum(dim=1, keepdim=True)
        spare = (count - real.sum(dim=1, keepdim=True)) / torch.where(total > 0, total, 1)
        # Rounded sums of numbers of at least 1 rise by at least 1, so that no span goes without. Of
        # two halves one apart, `round` would make the same even number.
        last = ((real + spare * length).cumsum(dim=1) + 0.5).floor()
        last[:, -1] = count
        index = torch.arange(count, dtype=begin.dtype, device=begin.device)
        index = index.expand(len(begin), count).contiguous()
        span = torch.searchsorted(last, index, right=True).clamp_max(spans - 1)
        before = torch.cat([torch.zeros_like(last[:, :1]), last[:, :-1]], dim=1).gather(1, span)
        offset = (
            0.5 if generator is None else torch.rand(index.shape, generator=generator).to(begin)
        )
        share = (index - before + offset) / (last.gather(1, span) - before)
        t = torch.lerp(begin.gather(1, span), end.gather(1, span), share)
        if spacing == "linear":
            return t
        # The reciprocal of a reciprocal may lie beside the end of a span, and a span at the camera
        # before what disparity begins with.
        return (-1 / t).clamp(self.begin.gather(1, span), self.end.gather(1, span))

    def arranged(self, *samples: Float[Tensor, "rays _"]) -> Places:
        """Put samples and the gaps between the spans in order.

        Borders lie halfway between neighbouring samples of one span, and at the ends of gaps.

        Args:
            samples: (R, N) distances in the spans, at least one in each span; ascending if there is
                only one such set.
        """
        if not self.gaps.shape[1]:
            if len(samples) == 1:
                return Places(samples[0], edges_between(samples[0], self.near, self.far))
            t, order = merge(*samples)
            return Places(t, edges_between(t, self.near, self.far), order)
        t, order = merge(*samples, self.gaps)
        gap = order - sum(part.shape[1] for part in samples)
        is_gap = gap >= 0
        ends, begins = (part.gather(1, gap.clamp_min(0)) for part in (self.end, self.begin[:, 1:]))
        edges = edges_between(t, self.near, self.far)
        inner = torch.where(is_gap[:, 1:], ends[:, 1:], edges[:, 1:-1])
        edges[:, 1:-1] = torch.where(is_gap[:, :-1], begins[:, :-1], inner)
        return Places(t, edges, order, ~is_gap)


class Places(NamedTuple):
    """Samples and gaps of R rays, in ascending order.

    Attributes:
        t: (R, M) distances of samples, and the middles of gaps among them.
        edges: (R, M+1) borders of the intervals around them.
        order: (R, M) the column of each in what was put in order; None if it was in order.
        is_sample: (R, M) which of them are samples; None: all.
    """

    t: Float[Tensor, "rays places"]
    edges: Float[Tensor, "rays edges"]
    order: Int[Tensor, "rays places"] | None = None
    is_sample: Bool[Tensor, "rays places"] | None = None


def _united(runs: Runs) -> Runs:
    """Join runs of the same ray that overlap; they may come in any order."""
    group = torch.cat([runs.ray, runs.ray])
    t = torch.cat([runs.enter, runs.leave])
    change = torch.ones_like(group)
    change[len(runs.ray) :] = -1
    # By group and then by distance, beginnings before endings at the same distance.
    order = t.argsort(stable=True)
    order = order[group[order].argsort(stable=True)]
    group, t, change = group[order], t[order], change[order]
    # How many runs are open; all of a group are closed before the next begins.
    open_runs = change.cumsum(dim=0)
    return Runs(
        group[(open_runs == 1) & (change == 1)],
        t[(open_runs == 1) & (change == 1)],
        t[open_runs == 0],
    )


def _rows(
    runs: Runs, count: Int[Tensor, " rays"]
) -> tuple[Float[Tensor, "rays spans"], Float[Tensor, "rays spans"]]:
    """Lay out runs as rows, with zeros behind the last of each row."""
    width = max(int(count.max()), 1) if len(count) else 1
    before = count.cumsum(dim=0) - count
    column = torch.arange(len(runs.ray), device=count.device) - before[runs.ray]
    begin, end = (runs.enter.new_zeros(len(count), width) for _ in range(2))
    begin[runs.ray, column] = runs.enter
    end[runs.ray, column] = runs.leave
    return begin, end


def _filled(begin: Tensor, end: Tensor, count: Tensor, most: int) -> tuple[Tensor, Tensor, Tensor]:
    """Fill the smallest gaps, so that no row has more than `most` spans."""
    index = torch.arange(begin.shape[1], device=begin.device)
    gaps = begin[:, 1:] - end[:, :-1]
    gaps = gaps.masked_fill(index[1:] >= count[:, None], -1.0)
    kept: Bool[Tensor, "rays gaps"] = torch.zeros_like(gaps, dtype=torch.bool)
    kept.scatter_(1, gaps.topk(most - 1, dim=1).indices, True)
    kept &= gaps >= 0
    real = index < count[:, None]
    always = torch.ones_like(real[:, :1])
    begins = real & torch.cat([always, kept], dim=1)
    ends = real & torch.cat([kept, always], dim=1)
    ends.scatter_(1, (count[:, None] - 1).clamp_min(0), (count > 0)[:, None])
    runs = Runs(begins.nonzero()[:, 0], begin[begins], end[ends])
    count = torch.bincount(runs.ray, minlength=len(count))
    return *_rows(runs, count), count
