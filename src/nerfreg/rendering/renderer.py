"""The rendering of a training step: from rays to a `Rendering`, through the hooks."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.field.directions import WIDTH, spherical_harmonics
from nerfreg.field.grid_layout import FEATURES
from nerfreg.field.radiance_field import RadianceField
from nerfreg.hooks import Rays, Rendering, Samples, Step
from nerfreg.rendering.compositing import assemble, integrate
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.field_values import FieldValues
from nerfreg.rendering.sampling import edges_between, importance, merge, stratified


@runtime_checkable
class RenderHooks(Protocol):
    """The two hooks that are called while rays are rendered; `nerfreg.registry.Hooks` has both."""

    def ray_bounds(self, rays: Rays, step: Step) -> tuple[Tensor, Tensor]:
        """Return near and far of each ray, (R,) each, in world units."""

    def encoder_input(self, samples: Samples, step: Step) -> Samples:
        """Return what the encoders see instead of `samples`."""


class Renderer:
    """Renders the rays of a training step.

    It draws samples, evaluates the field through the hooks and composites.

    Attributes:
        field: The field that is rendered.
        sampler: How many samples there are, and how they are spaced.
        hooks: The hooks of the active plugins.
        points: Number of evaluations of the density so far.
    """

    def __init__(self, field: RadianceField, sampler: SamplerConfig, hooks: RenderHooks) -> None:
        self.field = field
        self.sampler = sampler
        self.hooks = hooks
        self.points = 0

    def render(self, rays: Rays, step: Step, like: Rendering | None = None) -> Rendering:
        """Render rays through the hooks.

        Without `like`, stratified samples come first, then importance samples where their weights
        are, and all are composited together: each point is evaluated once. Rays of one group get
        the same t, drawn from the mean of the group's weights.

        With `like`, its t is used again and the same samples are coloured, by one call of the
        density network with all R * N points in row-major order and one of the colour network.

        Args:
            rays: R rays.
            step: The step that they belong to.
            like: An earlier rendering of these rays.

        Returns:
            The rendering of the rays, with N samples each.
        """
        if like is not None:
            samples = self._encode(rays, like.t, step)
            values = self._evaluate(samples)
            # The earlier choice of coloured samples is kept although the weights may differ now: a
            # perturbation of colours has a row for each of these samples.
            color = self._color(values, samples.directions, samples.color_features)
            return assemble(rays, like.t, like.t_edges, values.density, color, like.colored)
        # Both evaluations of the field add to one gradient of the hash table, which saves zeroing
        # and adding a second one: 100 MB of writes per step at 2^19 entries per level.
        with self.field.grid.one_gradient():
            return self._sample_and_render(rays, step)

    def frozen(self) -> AbstractContextManager[None]:
        """Return a context in which nothing rendered has gradients for the field's weights."""
        return self.field.frozen()

    def _sample_and_render(self, rays: Rays, step: Step) -> Rendering:
        near, far = self.hooks.ray_bounds(rays, step)
        # The distributions along two rays can be compared sample by sample only if both have the
        # same t. So one row of t is drawn for each group, over a range that covers all its rays.
        near, far = _per_group(near, rays.groups, "amin"), _per_group(far, rays.groups, "amax")
        coarse = _per_ray(
            stratified(near, far, self.sampler.coarse, self.sampler.spacing, step.generator),
            rays.groups,
        )
        ray_near, ray_far = _per_ray(near, rays.groups), _per_ray(far, rays.groups)
        coarse_samples = self._encode(rays, coarse, step)
        first = self._evaluate(coarse_samples)
        # Where samples are placed has no gradient, but their values have: the coarse samples are
        # composited with the fine ones, so that the gradient goes through both evaluations.
        with torch.no_grad():
            edges = edges_between(coarse, ray_near, ray_far)
            weights = integrate(first.density, edges).weights
            fine = importance(
                # Edges are equal within a group. The smallest is exactly this value, while a mean
                # would be rounded.
                _per_group(edges, rays.groups, "amin"),
                # The mean sees what any ray of the group has hit, so that a surface that only one
                # of two neighbours meets gets samples on both.
                _per_group(weights, rays.groups, "mean"),
                self.sampler.fine,
                step.generator,
            )
            fine = _per_ray(fine, rays.groups)
            t, order = merge(coarse, fine)
        fine_samples = self._encode(rays, fine, step)
        both = first.followed_by(self._evaluate(fine_samples)).ordered(order)
        directions = _merged_directions(coarse_samples, fine_samples, order)
        edges = edges_between(t, ray_near, ray_far)
        color = self._color(both, directions, fine_samples.color_features)
        return assemble(rays, t, edges, both.density, color)

    def _encode(self, rays: Rays, t: Tensor, step: Step) -> Samples:
        samples = Samples(
            positions=rays.origins[:, None] + rays.directions[:, None] * t[..., None],
            directions=rays.directions,
            t=t,
            density_width=FEATURES * self.field.grid.layout.levels,
            color_width=WIDTH,
        )
        return self.hooks.encoder_input(samples, step)

    def _evaluate(self, samples: Samples) -> FieldValues:
        points = samples.t.numel()
        self.points += points
        raw = self.field.raw_density(samples.positions.reshape(-1, 3), samples.density_features)
        rows = torch.arange(points, device=raw.device).view(samples.t.shape)
        return FieldValues(self.field.density(raw).view(samples.t.shape), raw, rows)

    def _color(
        self,
        values: FieldValues,
        directions: Float[Tensor, "rays 3"] | Float[Tensor, "rays samples 3"],
        features: float | None,
    ) -> Callable[[Tensor, Tensor], Float[Tensor, "colored 3"]]:
        """Return a function that evaluates the colours of samples, given their indices."""

        def color(ray: Tensor, sample: Tensor) -> Float[Tensor, "colored 3"]:
            harmonics = _harmonics(directions, ray, sample)
            return self.field.color(values.picked(ray, sample), harmonics, features)

        return color


def _harmonics(directions: Tensor, ray: Tensor, sample: Tensor) -> Tensor:
    if directions.dim() == 2:
        # Computed once per ray and copied to its samples.
        return spherical_harmonics(directions).index_select(0, ray)
    return spherical_harmonics(directions[ray, sample])


def _merged_directions(coarse: Samples, fine: Samples, order: Tensor) -> Tensor:
    """Return (R, 3), or (R, N, 3) in the order of all samples where a plugin made them differ."""
    if coarse.directions.dim() == fine.directions.dim() == 2:
        return fine.directions
    parts = [
        given.directions
        if given.directions.dim() == 3
        else given.directions[:, None].expand(*given.t.shape, 3)
        for given in (coarse, fine)
    ]
    return torch.cat(parts, dim=1).gather(1, order[..., None].expand(-1, -1, 3))


def _per_group(values: Tensor, groups: Tensor | None, reduce: str) -> Tensor:
    """Return the smallest, largest or mean of the rows of each group; all rows without groups."""
    if groups is None:
        return values
    count = int(groups.max()) + 1
    index = groups if values.dim() == 1 else groups[:, None].expand_as(values)
    shape = (count, *values.shape[1:])
    # The zeros must not take part, or the smallest of positive values would be 0.
    return values.new_zeros(shape).scatter_reduce(0, index, values, reduce, include_self=False)


def _per_ray(values: Tensor, groups: Tensor | None) -> Tensor:
    """Return the row of each ray's group."""
    return values if groups is None else values[groups]
