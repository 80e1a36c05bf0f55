"""From rays to a rendering, through the hooks."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from nerfreg.field.directions import WIDTH, spherical_harmonics
from nerfreg.field.grid_layout import FEATURES
from nerfreg.field.radiance_field import RadianceField
from nerfreg.hooks import Rays, Rendering, Samples, Step
from nerfreg.rendering.compositing import assemble, integrate
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.sampling import edges_between, importance, merge, stratified


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

    def render(self, rays: Rays, step: Step, like: Rendering | None = None) -> Rendering:
        """Render rays through the hooks.

        Without `like`, coarse samples come first, then importance samples where their weights are,
        and all are composited together: each point is evaluated once. Rays of one group get the
        same t, drawn from the mean of the group's weights.

        With `like`, its t is taken over and the same samples are coloured, by one call of the
        density network with all R * N points in row-major order and one of the colour network.

        Args:
            rays: R rays.
            step: The step that they belong to.
            like: An earlier rendering of these rays.
        """
        if like is not None:
            samples = self._encode(rays, like.t, step)
            evaluation = self._evaluate(samples)
            return self._composite(rays, like.t, like.t_edges, evaluation, samples, like.colored)
        with self.field.grid.one_gradient():
            return self._sample_and_render(rays, step)

    def frozen(self) -> AbstractContextManager[None]:
        """Within this context, renderings have no gradient with respect to the field's weights."""
        return self.field.frozen()

    def _sample_and_render(self, rays: Rays, step: Step) -> Rendering:
        generator = step.generator if self.jitter else None
        near, far = self.hooks.ray_bounds(rays, step)
        near, far = _shared(near, rays.groups, "amin"), _shared(far, rays.groups, "amax")
        coarse = _spread(
            stratified(near, far, self.sampler.coarse, self.sampler.spacing, generator), rays.groups
        )
        ray_near, ray_far = _spread(near, rays.groups), _spread(far, rays.groups)
        first = self._evaluate(self._encode(rays, coarse, step))
        with torch.no_grad():
            edges = edges_between(coarse, ray_near, ray_far)
            weights = integrate(first.density, edges).weights
            fine = importance(
                _shared(edges, rays.groups, "amin"),
                _shared(weights, rays.groups, "mean"),
                self.sampler.fine,
                generator,
            )
            fine = _spread(fine, rays.groups)
            t, order = merge(coarse, fine)
        samples = self._encode(rays, fine, step)
        both = first.followed_by(self._evaluate(samples)).ordered(order)
        return self._composite(rays, t, edges_between(t, ray_near, ray_far), both, samples)

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

    def _composite(
        self,
        rays: Rays,
        t: Float[Tensor, "rays samples"],
        t_edges: Float[Tensor, "rays edges"],
        evaluation: FieldValues,
        samples: Samples,
        colored: Bool[Tensor, "rays samples"] | None = None,
    ) -> Rendering:
        def color(ray: Tensor, sample: Tensor) -> Float[Tensor, "colored 3"]:
            return self.field.color(
                _Pick.apply(evaluation.raw, evaluation.rows[ray, sample]),
                _harmonics(samples.directions, ray, sample),
                samples.color_features,
            )

        return assemble(rays, t, t_edges, evaluation.density, color, colored)


class FieldValues(NamedTuple):
    """The field at the samples of each ray.

    density: (R, N). raw: (K, 1 + geometry) outputs of the density network. rows: (R, N) which of them is a sample's.
    """

    density: Float[Tensor, "rays samples"]
    raw: Float[Tensor, "evaluated out"]
    rows: Int[Tensor, "rays samples"]

    def followed_by(self, other: FieldValues) -> FieldValues:
        """Both, the other's samples behind these."""
        return FieldValues(
            torch.cat([self.density, other.density], dim=1),
            torch.cat([self.raw, other.raw]),
            torch.cat([self.rows, other.rows + len(self.raw)], dim=1),
        )

    def ordered(self, order: Int[Tensor, "rays samples"]) -> FieldValues:
        """The samples of each ray in another order."""
        return FieldValues(
            _Permute.apply(self.density, order), self.raw, self.rows.gather(1, order)
        )


class _Permute(torch.autograd.Function):
    """`values.gather(1, order)` where every row of `order` is a permutation: nothing has to be added up backward."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, order: Tensor) -> Tensor:
        ctx.save_for_backward(order)
        return values.gather(1, order)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        [order] = ctx.saved_tensors
        return torch.empty_like(grads[0]).scatter_(1, order, grads[0]), None


class _Pick(torch.autograd.Function):
    """`values.index_select(0, rows)` where no row is taken twice: nothing has to be added up backward."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, rows: Tensor) -> Tensor:
        ctx.save_for_backward(rows)
        ctx.count = len(values)
        return values.index_select(0, rows)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        [rows] = ctx.saved_tensors
        return grads[0].new_zeros(ctx.count, *grads[0].shape[1:]).index_copy_(
            0, rows, grads[0]
        ), None


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
