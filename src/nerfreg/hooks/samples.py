"""What passes through the hooks between the rays of a step and its loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from nerfreg.hooks.rays import Rays
from nerfreg.numerics import MIN_OPACITY, log_alpha


@dataclass
class Samples:
    """What the encoders are about to see.

    Attributes:
        positions: (R, N, 3) in world units.
        directions: (R, 3), or (R, N, 3) if a plugin made them differ along a ray.
        t: (R, N) distances at which the field is evaluated.
        density_features: How many of the hash grid's features are alive, counted from the coarsest;
            None for all. Feature i is multiplied by clip(density_features - i, 0, 1); levels that
            are silenced are never evaluated.
        color_features: The same for the direction features of the colour network.
        density_width: How many features the grid has. Set by the core.
        color_width: How many features the direction encoding has. Set by the core.
    """

    positions: Float[Tensor, "rays samples 3"]
    directions: Float[Tensor, "rays 3"] | Float[Tensor, "rays samples 3"]
    t: Float[Tensor, "rays samples"]
    density_features: float | None = None
    color_features: float | None = None
    density_width: int = 0
    color_width: int = 0


@dataclass
class DensitySamples:
    """The densities of all samples of each ray, in order, before they are composited.

    Attributes:
        rays: The R rays.
        t: (R, N) where the field was evaluated.
        t_edges: (R, N+1) borders of the intervals, ascending.
        density: (R, N) per world unit; 0 where a plugin declared space empty.
        read_raw: Returns `raw`; the property calls it once.
    """

    rays: Rays
    t: Float[Tensor, "rays samples"]
    t_edges: Float[Tensor, "rays edges"]
    density: Float[Tensor, "rays samples"]
    read_raw: Callable[[], Float[Tensor, "rays samples"]] = field(repr=False)

    @cached_property
    def raw(self) -> Float[Tensor, "rays samples"]:
        """(R, N) raw density, before its activation (see `FieldView.activate`).

        It is 0, and means nothing, where a plugin declared space empty.
        """
        return self.read_raw()

    @property
    def deltas(self) -> Float[Tensor, "rays samples"]:
        """(R, N) lengths of the intervals in world units; density times length is thickness."""
        return self.t_edges.diff(dim=1)

    @property
    def positions(self) -> Float[Tensor, "rays samples 3"]:
        """(R, N, 3) in world units."""
        return self.rays.origins[:, None] + self.rays.directions[:, None] * self.t[..., None]


@dataclass
class ColorSamples:
    """The samples whose colour is about to be evaluated.

    Attributes:
        rays: The R rays.
        ray: (K,) which ray each sample lies on.
        t: (K,) its distance along that ray.
    """

    rays: Rays
    ray: Int[Tensor, " colored"]
    t: Float[Tensor, " colored"]

    @property
    def view(self) -> Int[Tensor, " colored"]:
        """(K,) the training view of each sample's ray, -1 for rays of all other cameras."""
        if self.rays.view is None:
            return torch.full_like(self.ray, -1)
        return self.rays.view[self.ray]

    @property
    def positions(self) -> Float[Tensor, "colored 3"]:
        """(K, 3) in world units."""
        rays = self.rays
        return rays.origins[self.ray] + rays.directions[self.ray] * self.t[:, None]


@dataclass
class Rendering:
    """What compositing made of the rays. Plugins read it and never write into it.

    Attributes:
        rays: The rays that were rendered.
        t_edges: (R, N+1) borders of the intervals, ascending. A gap, where plugins declare space
            empty, is an interval of its own, of density 0; the first border and the last are those
            of what is not empty. Intervals without length fill up rays with fewer gaps than others.
        t: (R, N) where the field was evaluated, inside the intervals; in a gap, its middle.
        density: (R, N) per world unit.
        tau: (R, N) optical thickness of each interval, density times length.
        log_transmittance: (R, N) logarithm of the light that reaches each interval.
        weights: (R, N) share of each interval in the ray's colour.
        opacity: (R,) sum of weights.
        depth: (R,) expected distance; the last border for empty rays.
        rgb: (R, 3) with background; NaN where only the density was asked for.
        colored: (R, N) samples whose colour was evaluated (weight above 1e-4).
    """

    rays: Rays
    t_edges: Float[Tensor, "rays edges"]
    t: Float[Tensor, "rays samples"]
    density: Float[Tensor, "rays samples"]
    tau: Float[Tensor, "rays samples"]
    log_transmittance: Float[Tensor, "rays samples"]
    weights: Float[Tensor, "rays samples"]
    opacity: Float[Tensor, " rays"]
    depth: Float[Tensor, " rays"]
    rgb: Float[Tensor, "rays 3"]
    colored: Bool[Tensor, "rays samples"]

    @cached_property
    def alphas(self) -> Float[Tensor, "rays samples"]:
        """Opacity of each interval, 1 - exp(-tau), without cancellation."""
        return -torch.expm1(-self.tau)

    @cached_property
    def log_weights(self) -> Float[Tensor, "rays samples"]:
        """Logarithm of the weights, log T + log(1 - exp(-tau)).

        It is -inf where tau is 0, and finite where the weight itself underflows.
        """
        return self.log_transmittance + log_alpha(self.tau)

    @property
    def visible(self) -> Bool[Tensor, " rays"]:
        """(R,) rays that hit something: opacity of at least `MIN_OPACITY`."""
        return self.opacity.detach() >= MIN_OPACITY

    def picked(self, index: Int[Tensor, " picked"]) -> Rendering:
        """Return some of the rays, without targets and without what refers to rays by number.

        Args:
            index: (P,) numbers of rays.
        """
        rows = {name: x[index] for name, x in vars(self).items() if name in ROWS}
        return replace(self, rays=self.rays.picked(index), **rows)


ROWS = tuple(part.name for part in fields(Rendering) if part.name != "rays")
"""The attributes of a rendering that have a row for each ray."""
