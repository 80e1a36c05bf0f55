"""The field as a step sees it, for plugins that evaluate it at points of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg.field.radiance_field import RadianceField
from nerfreg.hooks import ColorSamples, Rays, Samples, Step, TableLevel
from nerfreg.rendering.render_hooks import RenderHooks


@dataclass(frozen=True)
class SteppedField:
    """The field through `nerfreg_encoder_input` and `nerfreg_empty`; implements `FieldView`.

    Attributes:
        field: The field.
        hooks: The hooks of the active plugins.
        step: The step.
    """

    field: RadianceField
    hooks: RenderHooks
    step: Step

    @property
    def tables(self) -> Sequence[TableLevel]:
        """The levels of the hash grid from the coarsest; empty if another encoder replaced it."""
        return () if self.field.grid is None else self.field.grid.tables

    def empty(self, positions: Float[Tensor, "points 3"]) -> Bool[Tensor, " points"]:
        """Return which positions plugins declare empty, (P,)."""
        empty = self.hooks.empty(positions.detach(), self.step)
        return torch.zeros_like(positions[:, 0], dtype=torch.bool) if empty is None else empty

    def encode(self, positions: Float[Tensor, "points 3"]) -> Float[Tensor, "points features"]:
        """Return the encoding of positions, with features that are silenced at 0."""
        seen = self._seen(positions)
        with self.field.same_gradient():
            return self._all_features(*self.field.encode(self.field.unit(seen[0]), seen[2]))

    def density(self, positions: Float[Tensor, "points 3"]) -> Float[Tensor, " points"]:
        """Return the density per world unit, (P,)."""
        seen = self._seen(positions)
        with self.field.same_gradient():
            raw = self.field.raw_density(seen[0], seen[2])
        return self._but_empty(self.field.density(raw), seen)

    def density_gradient(
        self, positions: Float[Tensor, "points 3"], create_graph: bool = True
    ) -> Float[Tensor, "points 3"]:
        """Return the gradient of the density by position, (P, 3).

        Args:
            positions: (P, 3) in world units.
            create_graph: Whether the result has gradients itself, correct to second order.
        """
        with torch.enable_grad():
            gradient = self._gradient(positions, create_graph)
        return gradient if create_graph else gradient.detach()

    def color(
        self, positions: Float[Tensor, "points 3"], directions: Float[Tensor, "points 3"]
    ) -> Float[Tensor, "points 3"]:
        """Return the colours in [0, 1] of positions seen along unit directions, (P, 3)."""
        samples = self._samples(positions, directions)
        turned = samples.directions
        flat = turned if turned.dim() == 2 else turned.flatten(0, 1)
        with self.field.same_gradient():
            raw = self.field.raw_density(samples.positions.flatten(0, 1), samples.density_features)
        encoded = self.field.encode_directions(flat)
        # Points of their own, at distance 0 of rays that begin there and belong to no view.
        here = torch.arange(len(positions), device=positions.device)
        at_once = positions.new_zeros(len(positions))
        rays = Rays(positions, directions, at_once, at_once)
        more = self.hooks.color_input(ColorSamples(rays, here, at_once), self.step)
        return self.field.color(raw, encoded, samples.color_features, more)

    def activate(self, raw: Float[Tensor, "*points"]) -> Float[Tensor, "*points"]:
        """Return the density per world unit of raw densities."""
        return self.field.density(raw[..., None])

    def _gradient(self, positions: Tensor, create_graph: bool) -> Tensor:
        field = self.field
        if field.grid is None:
            at = positions if positions.requires_grad else positions.detach().requires_grad_()
            seen = self._seen(at)
            features, scale = field.encode(field.unit(seen[0]), seen[2])
            density = self._density_of(features, scale)
            (gradient,) = torch.autograd.grad(density.sum(), at, create_graph=create_graph)
            return self._but_empty(gradient, seen)
        seen = self._seen(positions)
        unit = field.unit(seen[0])
        with field.same_gradient():
            features, scale = field.encode(unit, seen[2])
        if not features.requires_grad:
            features = features.detach().requires_grad_()
        density = self._density_of(features, scale)
        # By the features first, and then through the grid by hand: its gradient by positions is an
        # operation of its own, which can be differentiated once more.
        (slope,) = torch.autograd.grad(density.sum(), features, create_graph=create_graph)
        return self._but_empty(field.grid.gradient(unit, slope) / (2 * field.half_box), seen)

    def _density_of(self, features: Tensor, scale: Tensor | None) -> Tensor:
        # By plain autograd: the fused kernels have a first derivative alone.
        return self.field.density(self.field.density_network(features, scale, plain=True))

    def _all_features(self, features: Tensor, scale: Tensor | None) -> Tensor:
        if scale is None:
            return features
        missing = len(scale) - features.shape[1]
        scaled = features * scale[: features.shape[1]]
        return torch.nn.functional.pad(scaled, (0, missing))

    def _samples(self, positions: Tensor, directions: Tensor) -> Samples:
        samples = Samples(
            positions=positions[:, None],
            directions=directions,
            t=positions.new_zeros(len(positions), 1),
            density_width=self.field.density_width,
            color_width=self.field.direction_width,
        )
        return self.hooks.encoder_input(samples, self.step)

    def _seen(self, positions: Tensor) -> tuple[Tensor, Tensor | None, float | None]:
        """Positions as the encoder sees them, which are empty, and how many features are alive."""
        # Density does not depend on the direction, but samples have one.
        ahead = positions.new_zeros(positions.shape)
        ahead[:, 2] = 1
        samples = self._samples(positions, ahead)
        empty = self.hooks.empty(positions.detach(), self.step)
        return samples.positions.flatten(0, 1), empty, samples.density_features

    def _but_empty(
        self, values: Tensor, seen: tuple[Tensor, Tensor | None, float | None]
    ) -> Tensor:
        empty = seen[1]
        if empty is None:
            return values
        return values.masked_fill(empty if values.dim() == 1 else empty[:, None], 0)
