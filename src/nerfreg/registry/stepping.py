"""The hooks of a step, from its rays to its loss, and of evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg.hooks import (
    ColorSamples,
    DensitySamples,
    EvaluatedView,
    OccupancyGrid,
    Rays,
    Rendering,
    Samples,
    Step,
)
from nerfreg.registry.caller import PluginCaller


@dataclass(frozen=True)
class Term:
    """One term of the loss: `weight * value` is added to it.

    Attributes:
        plugin: Name of the plugin that returned it.
        name: What the plugin calls it.
        weight: Of the plugin.
        value: The unweighted scalar.
    """

    plugin: str
    name: str
    weight: float
    value: Tensor


class SteppingHooks(PluginCaller):
    """What plugins change and compute in a step, while their windows are open."""

    def begin(self, step: Step) -> None:
        """Set all fields that have a schedule to their values in this step."""
        for plugin in self._scheduled:
            plugin.follow_schedules(step)

    def start(self, step: Step) -> None:
        """Tell the selected plugins that the first step is about to be made."""
        self._tell("nerfreg_start", self._users["nerfreg_start"], step)

    def step_end(self, step: Step) -> None:
        """Tell the active plugins that a step has been made."""
        self._tell("nerfreg_step_end", self._active("nerfreg_step_end", step), step)

    def end(self, step: Step) -> None:
        """Tell the selected plugins that the last step has been made."""
        self._tell("nerfreg_end", self._users["nerfreg_end"], step)

    def rays(self, rays: Rays, step: Step) -> Rays:
        """Return the rays as the plugins change them."""
        active = self._active("nerfreg_rays", step)
        if not active:
            return rays
        return self._ask_for(Rays, "nerfreg_rays", active, {"rays": rays, "step": step})

    def ray_bounds(self, rays: Rays, step: Step) -> tuple[Tensor, Tensor]:
        """Return near and far of each ray, (R,) each.

        Raises:
            PluginError: The answer is not two tensors with a value for each ray.
        """
        active = self._active("nerfreg_ray_bounds", step)
        if not active:
            return rays.near, rays.far
        answer = self._ask_for(tuple, "nerfreg_ray_bounds", active, {"rays": rays, "step": step})
        found = [_shape(part) for part in answer]
        if found != [_shape(rays.near)] * 2:
            wrong = f"returned {_listed(found)}; return near and far of {_shape(rays.near)} each"
            raise self._error("nerfreg_ray_bounds", active, step, wrong)
        near, far = answer
        return near, far

    def occupancy(self, step: Step) -> tuple[OccupancyGrid, ...]:
        """Return the grids outside of whose occupied cells space is declared empty.

        Raises:
            PluginError: An answer is no grid.
        """
        grids: list[OccupancyGrid] = []
        for name in self._active("nerfreg_occupancy", step):
            for answer in self._ask("nerfreg_occupancy", (name,), {"step": step}):
                if not isinstance(answer, OccupancyGrid):
                    wrong = f"returned {type(answer).__name__}; return an OccupancyGrid"
                    raise self._error("nerfreg_occupancy", (name,), step, wrong)
                grids.append(answer)
        return tuple(grids)

    def empty(
        self, positions: Float[Tensor, "points 3"], step: Step
    ) -> Bool[Tensor, " points"] | None:
        """Return which positions are declared empty, by functions or by grids; None if none can be.

        Raises:
            PluginError: An answer does not have a truth value for each position.
        """
        empty: Tensor | None = None
        for grid in self.occupancy(step):
            outside = ~grid.to(positions.device).contains(positions)
            empty = outside if empty is None else empty | outside
        for name in self._active("nerfreg_empty", step):
            given = {"positions": positions, "step": step}
            for answer in self._ask("nerfreg_empty", (name,), given):
                if answer.dtype != torch.bool or answer.shape != positions.shape[:1]:
                    found = f"{answer.dtype} {tuple(answer.shape)}"
                    wrong = f"returned {found}; return booleans ({len(positions)},)"
                    raise self._error("nerfreg_empty", (name,), step, wrong)
                empty = answer if empty is None else empty | answer
        return empty

    def encoder_input(self, samples: Samples, step: Step) -> Samples:
        """Return what the encoders see in place of `samples`."""
        active = self._active("nerfreg_encoder_input", step)
        if not active:
            return samples
        given = {"samples": samples, "step": step}
        return self._ask_for(Samples, "nerfreg_encoder_input", active, given)

    def density(self, samples: DensitySamples, step: Step) -> Float[Tensor, "rays samples"]:
        """Return the densities as the plugins change them.

        Raises:
            PluginError: The answer does not have a density for each sample.
        """
        active = self._active("nerfreg_density", step)
        if not active:
            return samples.density
        given = {"samples": samples, "step": step}
        density = self._ask_for(Tensor, "nerfreg_density", active, given)
        if density.shape != samples.density.shape:
            wrong = f"returned {_shape(density)}; return densities of {_shape(samples.density)}"
            raise self._error("nerfreg_density", active, step, wrong)
        return density

    def color_input(
        self, samples: ColorSamples, step: Step
    ) -> Float[Tensor, "colored inputs"] | None:
        """Return what the plugins add to the input of the colour network; None if they do not.

        Raises:
            PluginError: An answer does not have the width that its plugin declares.
        """
        parts = []
        for name in self._users["nerfreg_color_input"]:
            width = self.plugins[name].color_inputs
            given = {"samples": samples, "step": step}
            answers = self._ask("nerfreg_color_input", (name,), given)
            found = [tuple(answer.shape) for answer in answers]
            if found != [(len(samples.ray), width)]:
                wrong = (
                    f"returned shape {found[0] if found else None}, not {(len(samples.ray), width)}"
                    "; the property color_inputs tells the width"
                )
                raise self._error("nerfreg_color_input", (name,), step, wrong)
            parts += answers
        return torch.cat(parts, dim=1) if parts else None

    def rendering(self, rendering: Rendering, step: Step) -> Rendering:
        """Return the rendering as the plugins change it."""
        active = self._active("nerfreg_rendering", step)
        if not active:
            return rendering
        given = {"rendering": rendering, "step": step}
        return self._ask_for(Rendering, "nerfreg_rendering", active, given)

    def losses(self, rendering: Rendering, step: Step) -> list[Term]:
        """Return all terms of the active plugins, unweighted, each with its plugin's weight.

        Raises:
            PluginError: A term is not a scalar tensor, or there is no dictionary of terms.
        """
        terms = []
        for name in self._active("nerfreg_loss", step):
            # One plugin at a time, because the answer does not say whose it is.
            given = {"rendering": self._as_needed(name, rendering), "step": step}
            answers = self._ask("nerfreg_loss", (name,), given)
            if not all(isinstance(values, dict) for values in answers) or not answers:
                found = type(answers[0]).__name__ if answers else "None"
                wrong = f"returned {found}; return a dictionary of terms, {{}} for none"
                raise self._error("nerfreg_loss", (name,), step, wrong)
            for term, value in answers[0].items():
                if not isinstance(value, Tensor) or value.ndim != 0:
                    found = (
                        f"has shape {tuple(value.shape)}"
                        if isinstance(value, Tensor)
                        else f"is of type {type(value).__name__}"
                    )
                    wrong = f"term '{term}' {found}, return scalars, such as a mean over rays"
                    raise self._error("nerfreg_loss", (name,), step, wrong)
                terms.append(Term(name, term, float(self.plugins[name].weight), value))
        return terms

    def _as_needed(self, name: str, rendering: Rendering) -> Rendering:
        """The rendering with patches of the side that a plugin asks for.

        Patches have the largest side that any plugin asks for, but each gets what it is set to:
        one plugin may be selected twice, to compare two sides.
        """
        rays = rendering.rays
        if rays.patches is None and rays.unseen_patches is None:
            return rendering
        tiled = rays.tiled(self._patch_sides.get(name, 0))
        unchanged = tiled.patches is rays.patches and tiled.unseen_patches is rays.unseen_patches
        return rendering if unchanged else replace(rendering, rays=tiled)

    def metrics(self, view: EvaluatedView, step: Step) -> dict[str, float]:
        """Return what the selected plugins measure of a view, by "plugin.metric".

        Raises:
            PluginError: An answer is no dictionary.
        """
        found: dict[str, float] = {}
        for name in self._users["nerfreg_metrics"]:
            for values in self._ask("nerfreg_metrics", (name,), {"view": view, "step": step}):
                if not isinstance(values, dict):
                    wrong = f"returned {type(values).__name__}; return numbers by name"
                    raise self._error("nerfreg_metrics", (name,), step, wrong)
                found |= {f"{name}.{metric}": float(value) for metric, value in values.items()}
        return found


def _shape(value: object) -> str:
    return f"shape {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__


def _listed(parts: Sequence[str]) -> str:
    return " and ".join(parts) or "nothing"
