"""From rays to a rendering, through the hooks."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg.field.directions import WIDTH, spherical_harmonics
from nerfreg.field.grid_layout import FEATURES
from nerfreg.field.radiance_field import RadianceField
from nerfreg.hooks import Rays, Rendering, Samples, Step
from nerfreg.rendering.compositing import integrate, transmittance
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.sampling import edges_between, importance, merge, stratified

MIN_WEIGHT = 1e-4
"""Samples below this weight have no visible colour; the colour network does not run for them."""


@runtime_checkable
class RenderHooks(Protocol):
    """The two hook points inside rendering."""

    def ray_bounds(self, rays: Rays, step: Step) -> tuple[Tensor, Tensor]: ...

    def encoder_input(self, samples: Samples, step: Step) -> Samples: ...


class Renderer:
    """Renders rays in training: samples them, evaluates the field through the hooks, composites.

    jitter: whether samples lie anywhere in their strata or in the middle. points: evaluations of the density so far.
    """

    jitter = True

    def __init__(self, field: RadianceField, sampler: SamplerConfig, hooks: RenderHooks) -> None:
        self.field = field
        self.sampler = sampler
        self.hooks = hooks
        self.points = 0

    def render(self, rays: Rays, step: Step) -> Rendering:
        """Coarse samples first, importance samples where their weights are, all composited together.

        Each point is evaluated once. Rays of one group get the same t, drawn from the mean of the group's weights.
        """
        generator = step.generator if self.jitter else None
        near, far = self.hooks.ray_bounds(rays, step)
        near, far = _shared(near, rays.groups, "amin"), _shared(far, rays.groups, "amax")
        coarse = _spread(stratified(near, far, self.sampler.coarse, self.sampler.spacing, generator), rays.groups)
        ray_near, ray_far = _spread(near, rays.groups), _spread(far, rays.groups)
        first = self._encode(rays, coarse, step)
        coarse_raw = self._raw(first)
        with torch.no_grad():
            edges = edges_between(coarse, ray_near, ray_far)
            weights = integrate(self.field.density(coarse_raw), edges).weights
            fine = importance(
                _shared(edges, rays.groups, "amin"),
                _shared(weights, rays.groups, "mean"),
                self.sampler.fine,
                generator,
            )
            fine = _spread(fine, rays.groups)
            t, order = merge(coarse, fine)
        second = self._encode(rays, fine, step)
        fine_raw = self._raw(second)
        raw = torch.cat([coarse_raw, fine_raw], dim=1)
        return self._composite(rays, t, edges_between(t, ray_near, ray_far), raw, order, second)

    def rerender(self, rendering: Rendering, step: Step) -> Rendering:
        """The same rays at the same t, with colours for the same samples.

        One call of the density network with all R * N points in row-major order, then one of the colour network.
        """
        samples = self._encode(rendering.rays, rendering.t, step)
        raw = self._raw(samples)
        return self._composite(
            rendering.rays, rendering.t, rendering.t_edges, raw, None, samples, colored=rendering.colored
        )

    def _encode(self, rays: Rays, t: Tensor, step: Step) -> Samples:
        samples = Samples(
            positions=rays.origins[:, None] + rays.directions[:, None] * t[..., None],
            directions=rays.directions,
            t=t,
            density_width=FEATURES * self.field.grid.layout.levels,
            color_width=WIDTH,
        )
        return self.hooks.encoder_input(samples, step)

    def _raw(self, samples: Samples) -> Tensor:
        """Output of the density network, (R, N, 1 + geometry)."""
        rays, count = samples.t.shape
        self.points += rays * count
        raw = self.field.raw_density(samples.positions.reshape(-1, 3), samples.density_features)
        return raw.view(rays, count, -1)

    def _composite(
        self,
        rays: Rays,
        t: Float[Tensor, "rays samples"],
        t_edges: Float[Tensor, "rays edges"],
        raw: Float[Tensor, "rays samples out"],
        order: Tensor | None,
        samples: Samples,
        colored: Bool[Tensor, "rays samples"] | None = None,
    ) -> Rendering:
        """Composite; `order` says where in `raw` each of the ascending t lies, None where it is ascending already."""
        density = self.field.density(raw)
        if order is not None:
            density = density.gather(1, order)
        result = integrate(density, t_edges)
        if colored is None:
            colored = result.weights.detach() > MIN_WEIGHT
        ray, sample = colored.nonzero(as_tuple=True)
        place = sample if order is None else order[ray, sample]
        color = self.field.color(
            raw.flatten(0, 1).index_select(0, ray * raw.shape[1] + place),
            _harmonics(samples.directions, ray, sample),
            samples.color_features,
        )
        weights = result.weights[ray, sample]
        rgb = color.new_zeros(len(rays), 3).index_add(0, ray, weights[:, None] * color)
        if rays.background is not None:
            rgb = rgb + transmittance(result.tau)[:, None] * rays.background
        return Rendering(
            rays=rays,
            t_edges=t_edges,
            t=t,
            density=density,
            tau=result.tau,
            log_transmittance=result.log_transmittance,
            weights=result.weights,
            opacity=result.opacity,
            depth=result.depth,
            rgb=rgb,
            colored=colored,
        )


def _harmonics(directions: Tensor, ray: Tensor, sample: Tensor) -> Tensor:
    if directions.dim() == 2:
        return spherical_harmonics(directions).index_select(0, ray)
    return spherical_harmonics(directions[ray, sample])


def _shared(values: Tensor, groups: Tensor | None, reduce: str) -> Tensor:
    """One row per group: the smallest, largest or mean of its rays' rows. One per ray where there are no groups."""
    if groups is None:
        return values
    count = int(groups.max()) + 1
    index = groups if values.dim() == 1 else groups[:, None].expand_as(values)
    shape = (count, *values.shape[1:])
    return values.new_zeros(shape).scatter_reduce(0, index, values, reduce, include_self=False)


def _spread(values: Tensor, groups: Tensor | None) -> Tensor:
    return values if groups is None else values[groups]
