"""The rendering of a training step: from rays to a `Rendering`, through the hooks."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.field.radiance_field import RadianceField
from nerfreg.hooks import (
    ColorSamples,
    DensitySamples,
    FieldView,
    Rays,
    Rendering,
    Samples,
    Step,
)
from nerfreg.rendering.compositing import assemble, integrate
from nerfreg.rendering.config import SampleCounts, SamplerConfig
from nerfreg.rendering.emptiness import sampled_runs
from nerfreg.rendering.field_values import FieldValues
from nerfreg.rendering.groups import per_group, per_ray
from nerfreg.rendering.render_hooks import RenderHooks
from nerfreg.rendering.sampling import importance
from nerfreg.rendering.spans import MOST_SPANS, Places, Spans
from nerfreg.rendering.stepped_field import SteppedField


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

    def cast(self, rays: Rays, step: Step) -> Rays:
        """Return the rays of a step as the plugins change them, clipped to the box again."""
        changed = self.hooks.rays(rays, step)
        if changed.origins is rays.origins and changed.directions is rays.directions:
            return changed
        if step.scene is None:
            return changed
        near, far = step.scene.clipped(changed.origins.detach(), changed.directions.detach())
        return replace(changed, near=near, far=far)

    def render(
        self,
        rays: Rays,
        step: Step,
        like: Rendering | None = None,
        shift: Float[Tensor, "*samples 3"] | None = None,
        density_only: bool = False,
    ) -> Rendering:
        """Render rays through the hooks.

        Without `like`, stratified samples come first, then importance samples where their weights
        are, and all are composited together: each point is evaluated once. Rays of one group get
        the same t, drawn from the mean of the group's weights.

        With `like`, its t is used again and the same samples are coloured, by one call of the
        density network with all R * N points in row-major order and one of the colour network.

        Args:
            rays: R rays.
            step: The step that they belong to.
            like: An earlier rendering of as many rays.
            shift: What to add to the positions of the samples of `like`, in world units, of a shape
                that broadcasts to (R, N, 3).
            density_only: Whether to leave out colours; `rgb` is NaN then.

        Returns:
            The rendering of the rays, with N samples each.
        """
        if like is not None:
            samples, places = self._encode(rays, like.t, step, shift)
            values = self._evaluate(samples, places, step)
            # The earlier choice of coloured samples is kept although the weights may differ now: a
            # perturbation of colours has a row for each of these samples.
            colored = None if density_only else like.colored
            color = self._color(rays, like.t, values, samples.directions, samples, step)
            return self._composite(
                rays, like.t, like.t_edges, values, None if density_only else color, step, colored
            )
        # Both evaluations of the field add to one gradient of the hash table, which saves zeroing
        # and adding a second one: 100 MB of writes per step at 2^19 entries per level.
        with self.field.one_gradient():
            return self._sample_and_render(rays, step, density_only)

    def view(self, step: Step) -> FieldView:
        """Return the field as this step sees it."""
        return SteppedField(self.field, self.hooks, step)

    def frozen(self) -> AbstractContextManager[None]:
        """Return a context in which nothing rendered has gradients for the field's weights."""
        return self.field.frozen()

    def _sample_and_render(self, rays: Rays, step: Step, density_only: bool) -> Rendering:
        # The distributions along two rays can be compared sample by sample only if both have the
        # same t. So one row of t is drawn for each group, over spans that cover all its rays.
        shared, counts = self._spans(rays, step)
        groups, spans = rays.groups, shared.per_ray(rays.groups)
        coarse = per_ray(
            shared.stratified(counts.coarse, self.sampler.spacing, step.generator), groups
        )
        coarse_samples, positions = self._encode(rays, coarse, step)
        first = self._evaluate(coarse_samples, positions, step)
        # Where samples are placed has no gradient, but their values have: the coarse samples are
        # composited with the fine ones, so that the gradient goes through both evaluations.
        with torch.no_grad():
            places = spans.arranged(coarse)
            weights = integrate(first.arranged(places).density, places.edges).weights
            fine = importance(
                # Edges are equal within a group. The smallest is exactly this value, while a mean
                # would be rounded.
                per_group(places.edges, groups, "amin"),
                # The mean sees what any ray of the group has hit, so that a surface that only one
                # of two neighbours meets gets samples on both.
                per_group(weights, groups, "mean"),
                counts.fine,
                step.generator,
                None
                if places.is_sample is None
                else per_group(places.is_sample.to(weights), groups, "amin"),
            )
            fine = per_ray(fine, groups)
            places = spans.arranged(coarse, fine)
        fine_samples, positions = self._encode(rays, fine, step)
        values = first.followed_by(self._evaluate(fine_samples, positions, step)).arranged(places)
        directions = _merged_directions(coarse_samples, fine_samples, places)
        color = self._color(rays, places.t, values, directions, fine_samples, step)
        return self._composite(
            rays, places.t, places.edges, values, None if density_only else color, step
        )

    def _spans(self, rays: Rays, step: Step) -> tuple[Spans, SampleCounts]:
        """Return where each group of rays is sampled, and how often."""
        near, far = self.hooks.ray_bounds(rays, step)
        groups = rays.groups
        whole = per_group(near, groups, "amin"), per_group(far, groups, "amax")
        runs = sampled_runs(self.hooks, rays, near, far, step)
        if runs is None:
            return Spans.whole(*whole), self.sampler.counts
        counts = self.sampler.counts_inside
        return Spans.of(runs, groups, *whole, most=min(MOST_SPANS, counts.coarse)), counts

    def _composite(
        self,
        rays: Rays,
        t: Tensor,
        edges: Tensor,
        values: FieldValues,
        color: Callable[[Tensor, Tensor], Tensor] | None,
        step: Step,
        colored: Tensor | None = None,
    ) -> Rendering:
        """Composite samples, and let plugins change their densities before and the result after."""
        density = values.density
        if self.hooks.changes("nerfreg_density", step):
            density = self.hooks.density(
                DensitySamples(rays, t, edges, density, lambda: values.raw_density), step
            )
        return self.hooks.rendering(assemble(rays, t, edges, density, color, colored), step)

    def _encode(
        self, rays: Rays, t: Tensor, step: Step, shift: Tensor | None = None
    ) -> tuple[Samples, Float[Tensor, "rays samples 3"]]:
        """Return what the encoders see of samples, and where these lie."""
        positions = rays.origins[:, None] + rays.directions[:, None] * t[..., None]
        if shift is not None:
            positions = positions + shift
        samples = Samples(
            positions=positions,
            directions=rays.directions,
            t=t,
            density_width=self.field.density_width,
            color_width=self.field.direction_width,
        )
        return self.hooks.encoder_input(samples, step), positions

    def _evaluate(
        self, samples: Samples, places: Float[Tensor, "rays samples 3"], step: Step
    ) -> FieldValues:
        """Evaluate the density of samples, but for those that lie in empty space.

        Whether space is empty depends on where samples lie, not on where a plugin lets the encoders
        see them; views and `Step.field` ask in the same way.
        """
        positions, shape = samples.positions.reshape(-1, 3), samples.t.shape
        empty = self.hooks.empty(places.detach().view(-1, 3), step)
        if empty is not None:
            seen = (~empty).nonzero().squeeze(1)
            positions = positions.index_select(0, seen)
        self.points += len(positions)
        raw = self.field.raw_density(positions, samples.density_features)
        density, rows = self.field.density(raw), torch.arange(len(raw), device=raw.device)
        if empty is not None:
            return FieldValues.scattered(density, raw, seen, shape)
        return FieldValues(density.view(shape), raw, rows.view(shape))

    def _color(
        self,
        rays: Rays,
        t: Tensor,
        values: FieldValues,
        directions: Float[Tensor, "rays 3"] | Float[Tensor, "rays samples 3"],
        samples: Samples,
        step: Step,
    ) -> Callable[[Tensor, Tensor], Float[Tensor, "colored 3"]]:
        """Return a function that evaluates the colours of samples, given their indices."""
        asked = self.hooks.changes("nerfreg_color_input", step)

        def color(ray: Tensor, sample: Tensor) -> Float[Tensor, "colored 3"]:
            encoded = self.field.encode_along(directions, ray, sample)
            more = (
                self.hooks.color_input(ColorSamples(rays, ray, t[ray, sample]), step)
                if asked
                else None
            )
            return self.field.color(
                values.picked(ray, sample), encoded, samples.color_features, more
            )

        return color


def _merged_directions(coarse: Samples, fine: Samples, places: Places) -> Tensor:
    """Return (R, 3), or (R, M, 3) in the order of all places where a plugin made them differ."""
    if coarse.directions.dim() == fine.directions.dim() == 2 or places.order is None:
        return fine.directions
    parts = [
        given.directions
        if given.directions.dim() == 3
        else given.directions[:, None].expand(*given.t.shape, 3)
        for given in (coarse, fine)
    ]
    gaps = places.order.shape[1] - sum(part.shape[1] for part in parts)
    # Nothing is seen in gaps, from wherever.
    parts.append(parts[0].new_zeros(len(parts[0]), gaps, 3))
    return torch.cat(parts, dim=1).gather(1, places.order[..., None].expand(-1, -1, 3))
