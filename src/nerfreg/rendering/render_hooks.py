"""The hooks that are called while rays are rendered, in training and in evaluation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from nerfreg.hooks import (
    ColorSamples,
    DensitySamples,
    OccupancyGrid,
    Rays,
    Rendering,
    Samples,
    Step,
)


@runtime_checkable
class RenderHooks(Protocol):
    """The hooks that are called while rays are rendered; `nerfreg.registry.Hooks` has all."""

    def rays(self, rays: Rays, step: Step) -> Rays:
        """Return the rays as the plugins change them."""

    def ray_bounds(self, rays: Rays, step: Step) -> tuple[Tensor, Tensor]:
        """Return near and far of each ray, (R,) each, in world units."""

    def occupancy(self, step: Step) -> tuple[OccupancyGrid, ...]:
        """Return the grids outside of whose occupied cells space is declared empty."""

    def empty(self, positions: Tensor, step: Step) -> Tensor | None:
        """Return which positions (P, 3) are declared empty, (P,); None: none of them."""

    def encoder_input(self, samples: Samples, step: Step) -> Samples:
        """Return what the encoders see instead of `samples`."""

    def changes(self, hook: str, step: Step) -> bool:
        """Return whether an active plugin implements a hook."""

    def density(self, samples: DensitySamples, step: Step) -> Tensor:
        """Return the densities (R, N) as the plugins change them."""

    def color_input(self, samples: ColorSamples, step: Step) -> Tensor | None:
        """Return what plugins add to the input of the colour network, (K, inputs), or None."""

    def rendering(self, rendering: Rendering, step: Step) -> Rendering:
        """Return the rendering as the plugins change it."""


@dataclass(frozen=True)
class EvaluationHooks:
    """The hooks that take part in an evaluation, without the step; None for those that do not.

    Attributes:
        rays: See `RenderHooks.rays`; so are the others.
        occupancy: The grids outside of whose occupied cells space is empty.
    """

    rays: Callable[[Rays], Rays] | None = None
    empty: Callable[[Tensor], Tensor] | None = None
    encoder_input: Callable[[Samples], Samples] | None = None
    density: Callable[[DensitySamples], Tensor] | None = None
    color_input: Callable[[ColorSamples], Tensor | None] | None = None
    rendering: Callable[[Rendering], Rendering] | None = None
    occupancy: tuple[OccupancyGrid, ...] = ()

    @classmethod
    def of(cls, hooks: RenderHooks | None, step: Step | None) -> EvaluationHooks:
        """Return those of the hooks that take part.

        Args:
            hooks: The hooks of a run; None where no plugin takes part.
            step: Where the run stands, in evaluation; None where no plugin takes part.
        """
        if hooks is None or step is None:
            return cls()

        def empty(positions: Tensor, step: Step) -> Tensor:
            found = hooks.empty(positions, step)
            if found is not None:
                return found
            return torch.zeros(len(positions), dtype=torch.bool, device=positions.device)

        calls: dict[str, Any] = {
            "rays": hooks.rays,
            "empty": empty,
            "encoder_input": hooks.encoder_input,
            "density": hooks.density,
            "color_input": hooks.color_input,
            "rendering": hooks.rendering,
        }
        grids = hooks.occupancy(step)
        return cls(
            occupancy=grids,
            **{
                name: partial(call, step=step)
                for name, call in calls.items()
                if hooks.changes(f"nerfreg_{name}", step) or (name == "empty" and grids)
            },
        )
