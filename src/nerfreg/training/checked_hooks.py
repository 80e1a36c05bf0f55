"""Hooks that look at what plugins return while a run goes on (`train.check=true`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch

from nerfreg.errors import PluginError
from nerfreg.hooks import (
    ColorSamples,
    DensitySamples,
    Rays,
    Regularizer,
    Rendering,
    Samples,
    Step,
)
from nerfreg.registry import Hooks
from nerfreg.scenes.scene import SceneInfo
from nerfreg.training.contracts import (
    Untouched,
    wrong_bounds,
    wrong_known_depth,
    wrong_layer,
    wrong_needs,
    wrong_samples,
    wrong_terms,
)
from nerfreg.training.contracts_rendering import (
    wrong_color_input,
    wrong_density,
    wrong_empty,
    wrong_metrics,
    wrong_occupancy,
    wrong_rays,
    wrong_rendering,
    wrong_unseen_poses,
)
from nerfreg.training.contracts_setup import wrong_encoder, wrong_module, wrong_prepared

Given = dict[str, Any]
WATCHED = Rays | Samples | DensitySamples | ColorSamples | Rendering | SceneInfo
"""What a hook gets and must not edit."""


class CheckedHooks(Hooks):
    """Calls what `Hooks` calls, in the same order and no more often, and refuses wrong answers.

    An error names plugin, hook, step and what is wrong; where several plugins transform one thing
    in turn, it names all of them. Layers are looked at when they are made, everything else in
    every `every`-th step.
    """

    def __init__(self, plugins: dict[str, Regularizer] | None = None, every: int = 1) -> None:
        super().__init__(plugins)
        self._every = every

    def _ask(self, hook: str, plugins: tuple[str, ...], given: Given) -> Any:
        step = given.get("step")
        if hook not in MISTAKES or (step is not None and step.index % self._every != 0):
            return super()._ask(hook, plugins, given)
        # A plugin may give the attributes of Samples new values; only their tensors are shared
        # with others.
        before = {k: replace(v) if isinstance(v, Samples) else v for k, v in given.items()}
        watched = {
            name: Untouched(value) for name, value in before.items() if isinstance(value, WATCHED)
        }
        answer = super()._ask(hook, plugins, given)
        wrong = [f"{name}.{edit}" for name, watch in watched.items() for edit in watch.edits()]
        wrong += MISTAKES[hook](before, answer)
        if wrong:
            self._refuse(hook, plugins, step, wrong)
        return answer

    def _refuse(
        self, hook: str, plugins: tuple[str, ...], step: Step | None, wrong: list[str]
    ) -> None:
        who = f"plugin{'s' if len(plugins) > 1 else ''} {', '.join(plugins)}"
        when = "" if step is None else f" at step {step.index}"
        raise PluginError(f"{who}, {hook}{when}: {'; '.join(wrong)}")


def _layer(given: Given, answer: Any) -> list[str]:
    which = f"layer {given['index']} of the {given['network']} network"
    wrong = wrong_layer(answer, given["in_features"], given["out_features"])
    return [f"{which}: {line}" for line in wrong]


def _ray_bounds(given: Given, answer: Any) -> list[str]:
    if not (isinstance(answer, tuple) and len(answer) == 2):
        return ["returned something else than (near, far)"]
    return wrong_bounds(*answer, given["rays"])


def _loss(given: Given, answers: Any) -> list[str]:
    # Training is in float32; of other precisions, which `nerfreg check` tries, a loss may return
    # another one.
    plain = given["rendering"].density.dtype == torch.float32
    dtype = torch.float32 if plain else None
    return [line for terms in answers for line in wrong_terms(terms, dtype)]


def _unseen_poses(given: Given, answers: Any) -> list[str]:
    views = len(given["scene_info"].cameras)
    return [line for poses in answers for line in wrong_unseen_poses(poses, given["count"], views)]


def _each(wrong: Callable[[Any], list[str]]) -> Callable[[Given, Any], list[str]]:
    """For a hook that every plugin answers."""
    return lambda _, answers: [line for answer in answers for line in wrong(answer)]


def _each_of(
    name: str, wrong: Callable[[Any, Any], list[str]]
) -> Callable[[Given, Any], list[str]]:
    """For a hook that every plugin answers, by what it was given."""
    return lambda given, answers: [
        line for answer in answers for line in wrong(given[name], answer)
    ]


MISTAKES: dict[str, Callable[[Given, Any], list[str]]] = {
    "nerfreg_encoder": lambda _, answer: wrong_encoder(answer),
    "nerfreg_layer": _layer,
    "nerfreg_module": _each(wrong_module),
    "nerfreg_prepare": _each_of("photographs", wrong_prepared),
    "nerfreg_known_depth": _each(wrong_known_depth),
    "nerfreg_needs": _each(wrong_needs),
    "nerfreg_unseen_poses": _unseen_poses,
    "nerfreg_rays": lambda given, answer: wrong_rays(given["rays"], answer),
    "nerfreg_ray_bounds": _ray_bounds,
    "nerfreg_occupancy": _each(wrong_occupancy),
    "nerfreg_empty": _each_of("positions", wrong_empty),
    "nerfreg_encoder_input": lambda given, answer: wrong_samples(given["samples"], answer),
    "nerfreg_density": lambda given, answer: wrong_density(given["samples"], answer),
    "nerfreg_color_input": _each_of("samples", wrong_color_input),
    "nerfreg_rendering": lambda given, answer: wrong_rendering(given["rendering"], answer),
    "nerfreg_loss": _loss,
    "nerfreg_metrics": _each(wrong_metrics),
}
"""Tells the mistakes in what a hook returned, by what it was given."""
