"""All hook points: the page to read before writing a regularizer.

A plugin is a dataclass that derives from `Regularizer`; its fields are its configuration (typed,
with defaults), and the core calls its methods marked `@hookimpl` at the points specified in
`HookSpecs`. R is the number of rays of a step, S the number of those that have a photograph behind
them (they come first), N the number of samples on each ray, V the number of training views.

A plugin that transforms something writes a wrapper around the answer of the core, or of the plugin
before it:

    @hookimpl(wrapper=True)
    def nerfreg_ray_bounds(self, rays, step):
        near, far = yield
        return near, far * 0.5

An implementation may leave out the arguments that it does not use.

Hooks that take a step are called while the plugin's weight is not 0 and its window is open. In
evaluation, when views are rendered, only these are called, with `step.training` False:
`nerfreg_occupancy`, `nerfreg_empty` and `nerfreg_color_input` always, and `nerfreg_rays`,
`nerfreg_encoder_input`, `nerfreg_density` and `nerfreg_rendering` of plugins that list them in
`in_evaluation`. They may be called from several threads at once there.
"""

from __future__ import annotations

from typing import Any

import pluggy
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from nerfreg.hooks.evaluated import EvaluatedView
from nerfreg.hooks.occupancy import OccupancyGrid
from nerfreg.hooks.rays import Needs, Rays
from nerfreg.hooks.regularizer import TrainedModule
from nerfreg.hooks.samples import ColorSamples, DensitySamples, Rendering, Samples
from nerfreg.hooks.step import Step
from nerfreg.scenes.scene import Photographs, SceneInfo

PROJECT = "nerfreg"
hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)

ALWAYS_IN_EVALUATION = ("nerfreg_occupancy", "nerfreg_empty", "nerfreg_color_input")
"""Hooks that are called in evaluation whatever the plugin says: without them, the field would be
read where it was never trained, or its colour network would lack inputs."""

IN_EVALUATION_IF_ASKED = (
    "nerfreg_rays",
    "nerfreg_encoder_input",
    "nerfreg_density",
    "nerfreg_rendering",
)
"""Hooks that are called in evaluation for plugins that name them in `Regularizer.in_evaluation`."""


class HookSpecs:
    """All hooks, in the order in which a run calls them; the last two are for `nerfreg check`."""

    @hookspec(firstresult=True)
    def nerfreg_encoder(self, which: str, scene_info: SceneInfo) -> nn.Module | None:
        """Make an encoder in place of the core's, when the field is built.

        The core encodes positions by a hash grid and directions by spherical harmonics. Another
        encoder runs through autograd. `Samples.density_features` and `Samples.color_features`
        silence the last of its features, whose order should therefore be from coarse to fine.

        Args:
            which: "positions" or "directions".
            scene_info: What is known of the scene.

        Returns:
            A module from (P, 3) to (P, width) with an attribute `width`. Positions lie in [0, 1],
            in the cube around the scene's box; directions are unit vectors.
        """

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
    def nerfreg_module(
        self, scene_info: SceneInfo, encoding_width: int
    ) -> nn.Module | TrainedModule | None:
        """Make a module with parameters and buffers of the plugin's own, when the field is built.

        The module is part of the field: it moves to its device, is saved and restored with its
        weights, and has its own group in the optimizer. The plugin keeps a reference and uses it in
        other hooks.

        Args:
            scene_info: What is known of the scene.
            encoding_width: Number of features of an encoded position (`FieldView.encode`).
        """

    @hookspec
    def nerfreg_prepare(self, photographs: Photographs) -> dict[str, Tensor] | None:
        """Find out something about each pixel of the training views, before the first step.

        Called once; the time it takes is training time. The answers come back with the rays of
        every step, gathered, as `rays.data["plugin.name"]`: `f"{self.instance}.{name}"`.

        Args:
            photographs: The training views, with the files they come from, and with the depth that
                plugins know.

        Returns:
            By name, values of each pixel, (V, H, W, ...).
        """

    @hookspec
    def nerfreg_known_depth(
        self, photographs: Photographs
    ) -> Float[Tensor, "views height width 2"] | None:
        """Tell the depth of training pixels, found in the photographs or read from elsewhere.

        Called once, before the first step; the time it takes is training time. The answer comes
        back with the rays of every step, as `rays.known_depth`. Where several plugins know the
        depth of a pixel, it is the intersection of their intervals, or the narrower one if they
        have nothing in common.

        Args:
            photographs: The training views.

        Returns:
            The interval of distance along each pixel's ray that contains a surface, in world units;
            NaN where that is not known.
        """

    @hookspec
    def nerfreg_start(self, step: Step) -> None:
        """Get ready, just before the first step.

        Called whatever the plugin's window.

        Args:
            step: The first step, whose field can be evaluated.
        """

    @hookspec
    def nerfreg_needs(self, step: Step) -> Needs | None:
        """Ask for patches, neighbours or unseen rays in the coming step.

        Args:
            step: Where the run stands.
        """

    @hookspec
    def nerfreg_unseen_poses(
        self, scene_info: SceneInfo, count: int, generator: torch.Generator
    ) -> (
        Float[Tensor, "count 3 4"] | tuple[Float[Tensor, "count 3 4"], Int[Tensor, " count"]] | None
    ):
        """Choose the poses of unseen rays that a plugin has asked for (`Needs.unseen_rays`).

        The core takes poses between two training views. If several plugins answer, each of them
        chooses an equal part.

        Args:
            scene_info: What is known of the scene.
            count: How many poses are needed, one for each ray or patch.
            generator: Source of all random choices.

        Returns:
            Camera-to-world matrices with OpenGL axes, (count, 3, 4), as those of
            `scene_info.cameras`. A pair with the numbers (count,) of the training views whose
            intrinsics the cameras have; without them, these are drawn at random.
        """

    @hookspec(firstresult=True)
    def nerfreg_rays(self, rays: Rays, step: Step) -> Rays | None:
        """Change the rays before they are sampled, such as by refined poses.

        What the targets count (`target_weights`) may be changed as well, by masks or robust losses.
        The core returns `rays`. Origins and directions that require a gradient get one, through the
        positions of the samples. Near and far are clipped to the scene's box again if the rays have
        moved. Called in evaluation if the plugin asks for it.

        Args:
            rays: The rays of the step; of a part of an image in evaluation.
            step: Where the run stands.

        Returns:
            Rays, made by `dataclasses.replace`; never change `rays` itself.
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

    @hookspec
    def nerfreg_occupancy(self, step: Step) -> OccupancyGrid | None:
        """Declare space empty by a grid of cells: there is nothing but in those that are occupied.

        Samples are spread over the occupied parts of rays by their length, each of which gets at
        least one; rays of pixels that met no occupied cell before the first step are not drawn.
        Empty space has no density, and the field is never evaluated there, in evaluation, too.
        With several plugins, space is empty if any of them says so.

        Args:
            step: Where the run stands.

        Returns:
            The grid, on any device: the same object in each step while the cells are the same,
            since what it takes to follow rays through it is found once. Outside of the grid, the
            nearest cell counts.
        """

    @hookspec
    def nerfreg_empty(
        self, positions: Float[Tensor, "points 3"], step: Step
    ) -> Bool[Tensor, " points"] | None:
        """Declare space empty by a function, where no grid of cells can tell.

        It does the same as `nerfreg_occupancy`, which costs less: each ray is probed at 128 points,
        and samples are spread over the parts around those that are not empty. Called before every
        evaluation of the field, in evaluation, too. Space is empty if any plugin says so.

        Args:
            positions: (P, 3) in world units.
            step: Where the run stands.

        Returns:
            Which positions are in empty space, (P,).
        """

    @hookspec(firstresult=True)
    def nerfreg_encoder_input(self, samples: Samples, step: Step) -> Samples | None:
        """Change what the encoders see: positions, directions, or how many features are alive.

        Called for every evaluation of the field in training. The core returns `samples`. Positions
        and directions that require a gradient get one. Called in evaluation if the plugin asks for
        it, as it must if it moves positions by what it has learned, or if a field that is evaluated
        during a run would be read where it has not been trained yet: the weights behind silenced
        features of an encoder of its own are those that the network began with.

        Args:
            samples: What the encoders would see. Where the density alone is asked for, at points
                that lie on no ray, `t` is 0 and the directions mean nothing.
            step: Where the run stands.
        """

    @hookspec(firstresult=True)
    def nerfreg_density(
        self, samples: DensitySamples, step: Step
    ) -> Float[Tensor, "rays samples"] | None:
        """Change the densities of all samples before they are composited.

        For dropout, noise, masks, or gradients that are scaled. The core returns `samples.density`.
        Where samples are placed does not depend on it: to keep them out of a place, declare it
        empty. Called in evaluation if the plugin asks for it.

        Args:
            samples: The samples of each ray.
            step: Where the run stands.

        Returns:
            Density per world unit, (R, N), never negative.
        """

    @hookspec
    def nerfreg_color_input(
        self, samples: ColorSamples, step: Step
    ) -> Float[Tensor, "colored inputs"] | None:
        """Give the colour network more inputs, such as an embedding of the view.

        The plugin says how many by its property `color_inputs`. Called in evaluation, too, and
        whatever the plugin's window: the network needs its inputs. Rays of views that are not
        trained on have `view` -1.

        Args:
            samples: The K samples whose colour is about to be evaluated.
            step: Where the run stands.

        Returns:
            Features, (K, color_inputs).
        """

    @hookspec(firstresult=True)
    def nerfreg_rendering(self, rendering: Rendering, step: Step) -> Rendering | None:
        """Change what compositing made of the rays, such as by an exposure or a tone curve.

        The core returns `rendering`. Called in evaluation if the plugin asks for it.

        Args:
            rendering: The rendering, with its colours on the background.
            step: Where the run stands.

        Returns:
            A rendering, made by `dataclasses.replace`; never change `rendering` itself.
        """

    @hookspec
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Float[Tensor, ""]]:
        """Return scalar terms by name, unweighted, reduced by the mean over rays.

        Called for plugins whose weight is not 0 and whose window is open. Never change `rendering`.

        Args:
            rendering: What compositing made of the step's rays.
            step: Where the run stands; renders again by `step.rerender`, and evaluates the field by
                `step.field`.
        """

    @hookspec
    def nerfreg_step_end(self, step: Step) -> None:
        """Do what follows the update of the weights.

        Called after every step that was used; not after one that was left out because its loss or
        a gradient was not finite.

        Args:
            step: The step that has just been made.
        """

    @hookspec
    def nerfreg_end(self, step: Step) -> None:
        """Finish, after the last step and before the checkpoint is saved.

        Called whatever the plugin's window.

        Args:
            step: Where the run stands.
        """

    @hookspec
    def nerfreg_metrics(self, view: EvaluatedView, step: Step) -> dict[str, float] | None:
        """Measure something of a rendered test view, or of the plugin's own state.

        The means over all views go to `results.json` and to reports, by the names "plugin.metric".

        Args:
            view: A test view at full size, as it was rendered, and its photograph.
            step: Where the run stood; `step.field` evaluates the field.

        Returns:
            Numbers by name; NaN for what could not be measured.
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
