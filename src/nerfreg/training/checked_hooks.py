"""Hooks that look at what plugins return, while a run goes on (`train.check=true`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from torch import Tensor, nn

from nerfreg.errors import NerfregError
from nerfreg.hooks import Needs, Rays, Regularizer, Rendering, Samples, Step
from nerfreg.registry import Hooks, Term
from nerfreg.training.contracts import (
    Untouched,
    wrong_bounds,
    wrong_layer,
    wrong_needs,
    wrong_samples,
    wrong_terms,
)


class CheckedHooks(Hooks):
    """Calls what `Hooks` calls, in the same order and no more often, and looks at it in every `every`-th step.

    Raises NerfregError with plugin, hook, step and what is wrong. Where several plugins transform one thing after
    the other, all of them are named. Layers are looked at when they are made.
    """

    def __init__(self, plugins: dict[str, Regularizer] | None = None, every: int = 1) -> None:
        super().__init__(plugins)
        self._every = every

    def needs(self, step: Step) -> Needs:
        if not self._due(step):
            return super().needs(step)
        union = Needs()
        for name in self._active("nerfreg_needs", step):
            for needs in self._manager((name,)).hook.nerfreg_needs(step=step):
                _refuse((name,), "nerfreg_needs", step, wrong_needs(needs))
                union |= needs
        return union

    def layer(
        self, network: str, index: int, in_features: int, out_features: int, activation: str
    ) -> nn.Module:
        layer = super().layer(network, index, in_features, out_features, activation)
        if makers := self._users["nerfreg_layer"]:
            wrong = [
                f"layer {index} of the {network} network: {line}"
                for line in wrong_layer(layer, in_features, out_features)
            ]
            _refuse(makers, "nerfreg_layer", None, wrong)
        return layer

    def ray_bounds(self, rays: Rays, step: Step) -> tuple[Tensor, Tensor]:
        active = self._active("nerfreg_ray_bounds", step)
        if not active or not self._due(step):
            return super().ray_bounds(rays, step)
        before = Untouched(rays)
        bounds: Any = self._manager(active).hook.nerfreg_ray_bounds(rays=rays, step=step)
        wrong = [f"rays.{edit}" for edit in before.edits()]
        if isinstance(bounds, tuple) and len(bounds) == 2:
            wrong += wrong_bounds(bounds[0], bounds[1], rays)
        else:
            wrong.append("returned something else than (near, far)")
        _refuse(active, "nerfreg_ray_bounds", step, wrong)
        near, far = bounds
        return near, far

    def encoder_input(self, samples: Samples, step: Step) -> Samples:
        active = self._active("nerfreg_encoder_input", step)
        if not active or not self._due(step):
            return super().encoder_input(samples, step)
        # A plugin may give its attributes new values; only the tensors are shared with others.
        given = replace(samples)
        before = Untouched(given)
        after: Samples = self._manager(active).hook.nerfreg_encoder_input(
            samples=samples, step=step
        )
        wrong = [f"samples.{edit}" for edit in before.edits()] + wrong_samples(given, after)
        _refuse(active, "nerfreg_encoder_input", step, wrong)
        return after

    def losses(self, rendering: Rendering, step: Step) -> list[Term]:
        if not self._due(step):
            return super().losses(rendering, step)
        terms = []
        for name in self._active("nerfreg_loss", step):
            before = Untouched(rendering)
            own = [
                Term(name, term, float(self.plugins[name].weight), value)
                for values in self._manager((name,)).hook.nerfreg_loss(
                    rendering=rendering, step=step
                )
                for term, value in values.items()
            ]
            wrong = [f"rendering.{edit}" for edit in before.edits()] + wrong_terms(own)
            _refuse((name,), "nerfreg_loss", step, wrong)
            terms += own
        return terms

    def _due(self, step: Step) -> bool:
        return step.index % self._every == 0


def _refuse(plugins: Sequence[str], hook: str, step: Step | None, wrong: Sequence[str]) -> None:
    if wrong:
        who = f"plugin{'s' if len(plugins) > 1 else ''} {', '.join(plugins)}"
        when = "" if step is None else f" at step {step.index}"
        raise NerfregError(f"{who}, {hook}{when}: {'; '.join(wrong)}")
