"""Where a ray through a medium is sampled: the choices of the renderers, on a known density."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg.bench.media import Medium
from nerfreg.rays.traversal import Runs
from nerfreg.rendering.compositing import integrate
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.occupancy import EMPTY_THICKNESS
from nerfreg.rendering.sampling import edges_between, importance, merge, stratified
from nerfreg.rendering.spans import Spans

CELLS = SamplerConfig().skip_resolution
LOOKS = 9
"""A medium that varies along the ray alone is looked at once in each of the 3 x 3 cells across that
count as one."""


class Sampled(NamedTuple):
    """Samples (R, N), borders of their intervals (R, N+1), and evaluations on an average ray."""

    t: Float[Tensor, "rays samples"]
    t_edges: Float[Tensor, "rays edges"]
    density: Float[Tensor, "rays samples"]
    evaluations: float


@dataclass(frozen=True)
class Bundle:
    """Rays from near to far (R,) through a medium, each with an occupancy grid of its own."""

    medium: Medium
    near: Float[Tensor, " rays"]
    far: Float[Tensor, " rays"]
    generator: torch.Generator

    @cached_property
    def occupied(self) -> Bool[Tensor, "rays cells"]:
        """Cells of the grid in which, or beside which, a look at the density found some."""
        cell = ((self.far - self.near) / CELLS)[:, None, None]
        shape = (len(self.near), CELLS, LOOKS)
        inside = torch.rand(shape, generator=self.generator, dtype=cell.dtype)
        t = self.near[:, None, None] + (torch.arange(CELLS)[:, None] + inside) * cell
        found = (self.medium.density(t) * cell > EMPTY_THICKNESS).any(dim=2)
        left, right = torch.zeros_like(found), torch.zeros_like(found)
        left[:, 1:], right[:, :-1] = found[:, :-1], found[:, 1:]
        return left | found | right

    def sampled(self, t: Tensor, density: Tensor, evaluations: float) -> Sampled:
        """Return samples with the intervals that belong to them."""
        return Sampled(t, edges_between(t, self.near, self.far), density, evaluations)


def uniform(bundle: Bundle, count: int) -> Sampled:
    """Sample the midpoints of equal parts."""
    t = stratified(bundle.near, bundle.far, count)
    return bundle.sampled(t, bundle.medium.density(t), float(count))


def jittered(bundle: Bundle, count: int) -> Sampled:
    """Sample anywhere in equal parts, as in training."""
    t = stratified(bundle.near, bundle.far, count, generator=bundle.generator)
    return bundle.sampled(t, bundle.medium.density(t), float(count))


def by_importance(bundle: Bundle, count: int) -> Sampled:
    """Sample a third at midpoints and the rest by their weights; composite all of them."""
    coarse = stratified(bundle.near, bundle.far, max(count // 3, 1))
    first = bundle.medium.density(coarse)
    edges = edges_between(coarse, bundle.near, bundle.far)
    fine = importance(edges, integrate(first, edges).weights, count - coarse.shape[1])
    t, order = merge(coarse, fine)
    density = torch.cat([first, bundle.medium.density(fine)], dim=1).gather(1, order)
    return bundle.sampled(t, density, float(count))


def skipping(bundle: Bundle, count: int) -> Sampled:
    """Sample midpoints, but evaluate the density in occupied cells alone; it is 0 elsewhere."""
    t = stratified(bundle.near, bundle.far, count)
    share = (t - bundle.near[:, None]) / (bundle.far - bundle.near)[:, None]
    cells = (share * CELLS).long().clamp_(0, CELLS - 1)
    seen = bundle.occupied.gather(1, cells).view(-1).nonzero().squeeze(1)
    density = torch.zeros_like(t)
    density.view(-1)[seen] = bundle.medium.density(t.view(-1)[seen])
    return bundle.sampled(t, density, len(seen) / len(t))


def inside(bundle: Bundle, count: int) -> Sampled:
    """Sample midpoints of parts of the windows alone, by their length, as training does."""
    windows, rays = bundle.near.new_tensor(bundle.medium.windows).view(-1, 2), len(bundle.near)
    ray = torch.arange(rays).repeat_interleave(len(windows))
    runs = Runs(ray, *windows.repeat(rays, 1).unbind(dim=1))
    spans = Spans.of(runs, None, bundle.near, bundle.far)
    places = spans.arranged(spans.stratified(count))
    density = bundle.medium.density(places.t)
    if places.is_sample is not None:
        density = density * places.is_sample
    return Sampled(places.t, places.edges, density, float(count))


SAMPLERS: dict[str, Callable[[Bundle, int], Sampled]] = {
    "uniform": uniform,
    "uniform_jittered": jittered,
    "importance": by_importance,
    "skipping": skipping,
    "inside": inside,
}


def samplers_of(medium: Medium) -> list[str]:
    """Return those that differ on a medium: without windows, `inside` is `uniform`."""
    return [name for name in SAMPLERS if medium.windows or name != "inside"]
