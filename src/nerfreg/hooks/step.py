"""Where a run stands, and what a plugin can ask of the field meanwhile."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from nerfreg.errors import NoRendererError
from nerfreg.hooks.rays import Rays
from nerfreg.hooks.samples import Rendering
from nerfreg.scenes.scene import SceneInfo


@runtime_checkable
class TableLevel(Protocol):
    """One level of the hash grid, to be read.

    Attributes:
        resolution: Cells per side of the cube around the scene's box.
        dense: Whether every vertex has an entry of its own; otherwise vertices share entries by a
            spatial hash.
        entries: Number of entries, E.
        table: (E, 2) their features, with gradients.
    """

    resolution: int
    dense: bool
    entries: int

    @property
    def table(self) -> Float[Tensor, "entries 2"]:
        """Return the entries of the level."""

    def features(self, vertices: Int[Tensor, "*vertices 3"]) -> Float[Tensor, "*vertices 2"]:
        """Return the features of vertices, given as integers from 0 to `resolution`."""

    def squared_differences(
        self, vertices: Int[Tensor, "*vertices 3"]
    ) -> Float[Tensor, "*vertices"]:
        """Return how much features change from vertices to the next ones along x, y and z.

        The squares are summed over features and axes; total variation is the mean of these, or of
        their roots. Vertices are integers from 0 to `resolution - 1`.
        """


@runtime_checkable
class FieldView(Protocol):
    """The field as the present step sees it: to be evaluated, not to be changed.

    Positions are in world units, (P, 3); outside of the scene's cube, where no ray is sampled, the
    field means nothing. All values have gradients by the weights, and by positions and directions
    that require one.
    """

    @property
    def tables(self) -> Sequence[TableLevel]:
        """The levels of the hash grid from the coarsest; empty if another encoder replaced it."""

    def empty(self, positions: Float[Tensor, "points 3"]) -> Bool[Tensor, " points"]:
        """Return which positions plugins declare empty, (P,)."""

    def encode(self, positions: Float[Tensor, "points 3"]) -> Float[Tensor, "points features"]:
        """Return the encoding of positions, with features that are silenced at 0."""

    def density(self, positions: Float[Tensor, "points 3"]) -> Float[Tensor, " points"]:
        """Return the density per world unit, (P,)."""

    def density_gradient(
        self, positions: Float[Tensor, "points 3"], create_graph: bool = True
    ) -> Float[Tensor, "points 3"]:
        """Return the gradient of the density by position, (P, 3).

        Normals are its negative, normalized.

        Args:
            positions: (P, 3) in world units.
            create_graph: Whether the result has gradients itself, correct to second order.
        """

    def color(
        self, positions: Float[Tensor, "points 3"], directions: Float[Tensor, "points 3"]
    ) -> Float[Tensor, "points 3"]:
        """Return the colours in [0, 1] of positions seen along unit directions, (P, 3)."""

    def activate(self, raw: Float[Tensor, "*points"]) -> Float[Tensor, "*points"]:
        """Return the density per world unit of raw densities."""


@runtime_checkable
class RayRenderer(Protocol):
    """Makes a Rendering from rays. The training's is `nerfreg.rendering.renderer.Renderer`."""

    def render(
        self,
        rays: Rays,
        step: Step,
        like: Rendering | None = None,
        shift: Float[Tensor, "*samples 3"] | None = None,
        density_only: bool = False,
    ) -> Rendering:
        """Render rays through the hooks.

        Args:
            rays: R rays.
            step: The step that they belong to.
            like: An earlier rendering of as many rays, whose t is taken over and for whose coloured
                samples colours are evaluated; None: samples are drawn.
            shift: What to add to the positions of the samples of `like`, in world units, of a shape
                that broadcasts to (R, N, 3).
            density_only: Whether to leave out colours; `rgb` is NaN then.
        """

    def cast(self, rays: Rays, step: Step) -> Rays:
        """Return the rays of a step as plugins change them (`nerfreg_rays`)."""

    def frozen(self) -> AbstractContextManager[None]:
        """Within this context, renderings have no gradient with respect to the field's weights."""

    def view(self, step: Step) -> FieldView:
        """Return the field that is rendered, as this step sees it."""


@dataclass
class Step:
    """Where the run stands.

    Attributes:
        index: Number of steps done before this one.
        total: Number of steps that the run will have, an estimate while the budget is in seconds.
        fraction: Share of the budget (steps or seconds) that is spent, 0 to 1.
        generator: The run's source of randomness, on the CPU. In evaluation it is another one,
            which always begins with the same seed.
        bounds: Near and far of the whole scene, in world units.
        renderer: What renders the rays of the step; None where there is no field.
        training: Whether the field is being trained; False while views are rendered.
        scene: What a plugin may know of the scene; None where there is none.
        averaged: Within this context, the field has the moving average of its weights; None where
            no average is kept.
    """

    index: int
    total: int
    fraction: float
    generator: torch.Generator
    bounds: tuple[float, float]
    renderer: RayRenderer | None = None
    training: bool = True
    scene: SceneInfo | None = None
    averaged: Callable[[], AbstractContextManager[None]] | None = None

    @property
    def field(self) -> FieldView:
        """The field as this step sees it.

        Raises:
            NoRendererError: There is no field.
        """
        return self._renderer().view(self)

    @property
    def teacher(self) -> Teacher:
        """The moving average of the weights, as a field that renders.

        Raises:
            NoRendererError: There is no field.
        """
        self._renderer()
        return Teacher(replace(self, training=False), self.averaged or nullcontext)

    def render(self, rays: Rays, frozen: bool = False) -> Rendering:
        """Render any rays, such as those of a warped patch, with samples of their own.

        The rays are taken as they are: `nerfreg_rays` is not called for them, and near and far are
        those that they have (`SceneInfo.clipped` finds those of the box).

        Args:
            rays: The rays.
            frozen: Whether to leave out gradients by the field's weights.

        Raises:
            NoRendererError: There is no renderer.
        """
        renderer = self._renderer()
        with renderer.frozen() if frozen else nullcontext():
            return renderer.render(rays, self)

    def rerender(
        self,
        rendering: Rendering,
        *,
        rays: Rays | None = None,
        shift: Float[Tensor, "*samples 3"] | None = None,
        density_only: bool = False,
        frozen: bool = False,
    ) -> Rendering:
        """Render the same rays at the same t, with the same samples coloured, through the hooks.

        Args:
            rendering: The rendering to repeat.
            rays: As many other rays, with other origins for example.
            shift: What to add to the positions of the samples, in world units, of a shape that
                broadcasts to (R, N, 3).
            density_only: Whether to leave out colours, which are most of the cost; `rgb` is NaN
                then.
            frozen: Whether to leave out gradients by the field's weights, for a search over what
                the field sees.

        Raises:
            NoRendererError: There is no renderer.
        """
        renderer = self._renderer()
        with renderer.frozen() if frozen else nullcontext():
            return renderer.render(
                rays or rendering.rays, self, rendering, shift=shift, density_only=density_only
            )

    def probe(self, rendering: Rendering) -> Rendering:
        """Do the same without gradients by the field's weights.

        Deprecated since hook version 2: `rerender(rendering, frozen=True)` does the same.
        """
        warnings.warn(
            "step.probe(rendering) is deprecated; write step.rerender(rendering, frozen=True)",
            DeprecationWarning,
            stacklevel=2,
        )
        return self.rerender(rendering, frozen=True)

    def _renderer(self) -> RayRenderer:
        if self.renderer is None:
            raise NoRendererError("this step has no renderer: its rays cannot be rendered again")
        return self.renderer


@dataclass(frozen=True)
class Teacher:
    """The field with the moving average of its weights; nothing that it returns has a gradient.

    It renders as in evaluation: hooks that act in training alone are not called.

    Attributes:
        step: The step, in evaluation.
        averaged: Within this context, the field has the averaged weights.
    """

    step: Step
    averaged: Callable[[], AbstractContextManager[None]]

    def render(self, rays: Rays) -> Rendering:
        """Render rays with samples of their own."""
        with self._average():
            return self.step.render(rays)

    def rerender(self, rendering: Rendering) -> Rendering:
        """Render the rays of a rendering at the same t, with the same samples coloured."""
        with self._average():
            return self.step.rerender(rendering)

    def density(self, positions: Float[Tensor, "points 3"]) -> Float[Tensor, " points"]:
        """Return the density per world unit at world positions (P, 3), (P,)."""
        with self._average():
            return self.step.field.density(positions)

    @contextmanager
    def _average(self) -> Iterator[None]:
        with self.averaged(), torch.no_grad():
            yield
