"""The hook points, and the few dataclasses that pass through them.

This is the page to read before writing a regularizer. A plugin is a dataclass that derives from
`Regularizer`; its fields are its configuration (typed, with defaults), and the core calls its
methods marked `@hookimpl` at the points specified in `HookSpecs`. R is the number of rays of a
step, N the number of samples on each ray.

A plugin that transforms something writes a wrapper around the answer of the core, or of the plugin
before it:

    @hookimpl(wrapper=True)
    def nerfreg_ray_bounds(self, rays, step):
        near, far = yield
        return near, far * 0.5

An implementation may leave out the arguments that it does not use.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import pluggy
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from nerfreg.errors import NoRendererError
from nerfreg.numerics import MIN_OPACITY, log_alpha
from nerfreg.scenes.scene import Photographs

PROJECT = "nerfreg"
hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


NEIGHBORS = ("none", "patch", "extra")
"""Where adjacent pixels come from. Of two requests the one later in this list wins."""


@dataclass(frozen=True)
class Needs:
    """What a plugin wants rendered beside random training pixels.

    The union over all active plugins is rendered.

    Attributes:
        patch_size: Side S of square pixel patches among the training rays, 0 for none; the union
            takes the largest.
        patch_fraction: Share of the training rays that lie in those patches.
        neighbors: Pairs of horizontally or vertically adjacent pixels, sampled at the same t.
            `"patch"` pairs rays of the patches (which are then at least 2 x 2) and costs no extra
            ray; `"extra"` renders one more ray, without a photograph behind it, for every training
            ray that lies in no patch.
        unseen_rays: Rays from poses between the training views, as a share of a step's rays. They
            take the place of training rays, so that a step costs no more.
        unseen_patches: Rays in patches of that side from such poses, likewise a share of a step's
            rays. They count as unseen rays: of both shares the larger is rendered.
    """

    patch_size: int = 0
    patch_fraction: float = 0.0
    neighbors: str = "none"
    unseen_rays: float = 0.0
    unseen_patches: float = 0.0

    def __or__(self, other: Needs) -> Needs:
        return Needs(
            max(self.patch_size, other.patch_size),
            max(self.patch_fraction, other.patch_fraction),
            max(self.neighbors, other.neighbors, key=NEIGHBORS.index),
            max(self.unseen_rays, other.unseen_rays),
            max(self.unseen_patches, other.unseen_patches),
        )


@dataclass
class Rays:
    """The rays of one step.

    Rays 0 to S-1 have a photograph behind them; the rest (extra neighbours, unseen views) do not.

    Attributes:
        origins: (R, 3) in world units.
        directions: (R, 3) of unit length, so that t is a distance.
        near: (R,) start of the part of each ray that is sampled.
        far: (R,) its end.
        targets: (S, 3) colours in [0, 1].
        background: (R, 3) what shines through where opacity is below 1; None where the photographs
            have no alpha.
        patches: (P, S, S) ray indices; rows run down the image, columns to the right. None if no
            plugin needs patches.
        neighbors: (M, 2) ray indices of adjacent pixels, first the ray, then its neighbour. Both
            share their t.
        unseen: (U,) indices of rays from unseen poses, or None.
        unseen_patches: (Q, S, S) those of them that form patches, or None.
        groups: (R,) rays with the same number share their t; None if no rays do.
        target_weights: (S,) what each target counts in the colour error, 1 on average; None where
            all are equal. A patch counts as much as one random pixel, since its pixels are nearly
            redundant.
        known_depth: (S, 2) interval of distance along the ray in which a plugin knew a surface
            before training; NaN where it did not, None if no plugin knew anything.
    """

    origins: Float[Tensor, "rays 3"]
    directions: Float[Tensor, "rays 3"]
    near: Float[Tensor, " rays"]
    far: Float[Tensor, " rays"]
    targets: Float[Tensor, "supervised 3"]
    background: Float[Tensor, "rays 3"] | None = None
    patches: Int[Tensor, "patches side side"] | None = None
    neighbors: Int[Tensor, "pairs 2"] | None = None
    unseen: Int[Tensor, " unseen"] | None = None
    unseen_patches: Int[Tensor, "unseen_patches width width"] | None = None
    groups: Int[Tensor, " rays"] | None = None
    target_weights: Float[Tensor, " supervised"] | None = None
    known_depth: Float[Tensor, "supervised 2"] | None = None

    def __len__(self) -> int:
        return len(self.origins)


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
class Rendering:
    """What compositing made of the rays. Plugins read it and never write into it.

    Attributes:
        rays: The rays that were rendered.
        t_edges: (R, N+1) borders of the intervals, ascending.
        t: (R, N) where the field was evaluated, inside the intervals.
        density: (R, N) per world unit.
        tau: (R, N) optical thickness of each interval, density times length.
        log_transmittance: (R, N) logarithm of the light that reaches each interval.
        weights: (R, N) share of each interval in the ray's colour.
        opacity: (R,) sum of weights.
        depth: (R,) expected distance; `far` for empty rays.
        rgb: (R, 3) with background.
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


@runtime_checkable
class RayRenderer(Protocol):
    """Makes a Rendering from rays. The training's is `nerfreg.rendering.renderer.Renderer`."""

    def render(self, rays: Rays, step: Step, like: Rendering | None = None) -> Rendering:
        """Render rays through the hooks.

        Args:
            rays: R rays.
            step: The step that they belong to.
            like: An earlier rendering of these rays, whose t is taken over and for whose coloured
                samples colours are evaluated; None: samples are drawn.
        """

    def frozen(self) -> AbstractContextManager[None]:
        """Within this context, renderings have no gradient with respect to the field's weights."""


@dataclass
class Step:
    """Where the run stands.

    Attributes:
        index: Number of steps done before this one.
        total: Number of steps that the run will have, an estimate while the budget is in seconds.
        fraction: Share of the budget (steps or seconds) that is spent, 0 to 1.
        generator: The run's source of randomness, on the CPU.
        bounds: Near and far of the whole scene, in world units.
        renderer: What renders the rays of the step; None where there is no field.
    """

    index: int
    total: int
    fraction: float
    generator: torch.Generator
    bounds: tuple[float, float]
    renderer: RayRenderer | None = None

    def rerender(self, rendering: Rendering) -> Rendering:
        """Render the same rays at the same t, with the same samples coloured, through the hooks.

        Raises:
            NoRendererError: There is no renderer.
        """
        return self._renderer().render(rendering.rays, self, like=rendering)

    def probe(self, rendering: Rendering) -> Rendering:
        """Do the same without gradients by the field's weights, which is cheaper.

        Meant for a search over what the field sees.

        Raises:
            NoRendererError: There is no renderer.
        """
        renderer = self._renderer()
        with renderer.frozen():
            return renderer.render(rendering.rays, self, like=rendering)

    def _renderer(self) -> RayRenderer:
        if self.renderer is None:
            raise NoRendererError("this step has no renderer: its rays cannot be rendered again")
        return self.renderer


@dataclass
class Regularizer:
    """Base of all plugins: a dataclass whose fields are the plugin's configuration.

    Three class variables are no configuration. `by_layout` maps a camera layout ("orbit" or
    "forward") to defaults that differ there, such as `{"forward": {"weight": 2e-5}}`; they hold
    wherever the user says nothing. `conflicts` names plugins that cannot be active in the same
    run. `cite` gives the sources for `nerfreg cite`: BibTeX text, or keys, separated by commas, of
    entries in a file `references.bib` in the package of the plugin's module or the closest parent
    package that has one.

    Attributes:
        weight: Factor of every term that `nerfreg_loss` returns; 0 switches the plugin off at no
            cost.
        start: When the plugin becomes active: a step (integer) or a fraction of the budget (0.0 to
            1.0).
        end: When it ceases to be active, likewise.
    """

    weight: float = 1.0
    start: int | float = 0.0
    end: int | float = 1.0

    by_layout: ClassVar[dict[str, dict[str, Any]]] = {}
    conflicts: ClassVar[tuple[str, ...]] = ()
    cite: ClassVar[str] = ""

    @property
    def scale_free(self) -> bool:
        """Whether the loss stays the same when all distances grow by a factor.

        `nerfreg check` verifies the claim.
        """
        return False

    def active(self, step: Step) -> bool:
        """Return whether `step` lies in [start, end); the last step belongs to `end: 1.0`."""
        begun = (
            step.index >= self.start if isinstance(self.start, int) else step.fraction >= self.start
        )
        if isinstance(self.end, int):
            return begun and step.index < self.end
        return begun and (step.fraction < self.end or self.end >= 1.0)


class HookSpecs:
    """All hooks, in the order in which a run calls them; the last two are for `nerfreg check`."""

    @hookspec(firstresult=True)
    def nerfreg_layer(
        self, network: str, index: int, in_features: int, out_features: int, activation: str
    ) -> nn.Module | None:
        """Make one layer of a network, when the field is built.

        The core makes a plain linear layer without bias.

        Args:
            network: "density" or "color".
            index: Number of the layer, from 0, the layer nearest the input.
            in_features: Width of its input.
            out_features: Width of its output.
            activation: "relu" for hidden layers, "none" for the last; the layer applies it itself.

        Returns:
            A module from (points, in_features) to (points, out_features). An `AffineLayer` tells
            its effective weight and bias and runs in the fused kernels; any other module runs
            through autograd.
        """

    @hookspec
    def nerfreg_known_depth(
        self, photographs: Photographs
    ) -> Float[Tensor, "views height width 2"] | None:
        """Tell the depth of training pixels, found in the photographs or read from elsewhere.

        Called once, before the first step; the time it takes is training time. The answer comes
        back with the rays of every step, as `rays.known_depth`. One plugin of a run may answer.

        Args:
            photographs: The training views.

        Returns:
            The interval of distance along each pixel's ray that contains a surface, in world units;
            NaN where that is not known.
        """

    @hookspec
    def nerfreg_needs(self, step: Step) -> Needs | None:
        """Ask for patches, neighbours or unseen rays in the coming step.

        Args:
            step: Where the run stands.
        """

    @hookspec(firstresult=True)
    def nerfreg_ray_bounds(
        self, rays: Rays, step: Step
    ) -> tuple[Float[Tensor, " rays"], Float[Tensor, " rays"]] | None:
        """Return near and far of each ray in training, (R,) each.

        The core returns those of `rays`.

        Args:
            rays: The rays that are about to be sampled.
            step: Where the run stands.
        """

    @hookspec(firstresult=True)
    def nerfreg_encoder_input(self, samples: Samples, step: Step) -> Samples | None:
        """Change what the encoders see: positions, directions, or how many features are alive.

        Called for every evaluation of the field in training. The core returns `samples`. Positions
        and directions that require a gradient get one.

        Args:
            samples: What the encoders would see.
            step: Where the run stands.
        """

    @hookspec
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Float[Tensor, ""]]:
        """Return scalar terms by name, unweighted, reduced by the mean over rays.

        Called for plugins whose weight is not 0 and whose window is open. Never change `rendering`.

        Args:
            rendering: What compositing made of the step's rays.
            step: Where the run stands; renders again by `step.rerender` and `step.probe`.
        """

    @hookspec
    def nerfreg_reference(
        self, given: nn.Module | Rays | Samples | Rendering, step: Step
    ) -> dict[str, Any] | None:
        """Return exact values of what the plugin makes of `given`, for `nerfreg check`.

        Args:
            given: A Rendering, Rays, Samples, or a layer that `nerfreg_layer` made. Its tensors
                count as exact: `nerfreg.numerics.exact` makes mpmath numbers of them, and 150
                digits are set.
            step: Where the run stands.

        Returns:
            Numbers or nested lists of numbers. Of a Rendering, the terms that `nerfreg_loss`
            returns, by name. Of Rays, "near" and "far". Of Samples, those of its attributes that
            the plugin changes, by name. Of a layer, "weight" and "bias" as
            `AffineLayer.effective` returns them.
        """

    @hookspec
    def nerfreg_contract(self, step: Step) -> dict[str, float]:
        """Return by how much each promise that the plugin makes of its own state is broken now.

        Called by `nerfreg check` whenever the plugin has been used, also inside `step.rerender`,
        while what it has set for that rendering is in force.

        Args:
            step: Where the run stands.

        Returns:
            The excess by the name of the promise, 0 where it is kept.
        """
