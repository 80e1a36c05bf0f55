"""Hooks that look at what plugins return while a run goes on (`train.check=true`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from nerfreg.errors import NerfregError
from nerfreg.hooks import Rays, Regularizer, Rendering, Samples
from nerfreg.registry import Hooks
from nerfreg.training.contracts import (
    Untouched,
    wrong_bounds,
    wrong_layer,
    wrong_needs,
    wrong_samples,
    wrong_terms,
)

Given = dict[str, Any]


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
            name: Untouched(value)
            for name, value in before.items()
            if isinstance(value, Rays | Samples | Rendering)
        }
        answer = super()._ask(hook, plugins, given)
        wrong = [f"{name}.{edit}" for name, watch in watched.items() for edit in watch.edits()]
        wrong += MISTAKES[hook](before, answer)
        if wrong:
            who = f"plugin{'s' if len(plugins) > 1 else ''} {', '.join(plugins)}"
            when = "" if step is None else f" at step {step.index}"
            raise NerfregError(f"{who}, {hook}{when}: {'; '.join(wrong)}")
        return answer


def _layer(given: Given, answer: Any) -> list[str]:
    which = f"layer {given['index']} of the {given['network']} network"
    wrong = wrong_layer(answer, given["in_features"], given["out_features"])
    return [f"{which}: {line}" for line in wrong]


def _ray_bounds(given: Given, answer: Any) -> list[str]:
    if not (isinstance(answer, tuple) and len(answer) == 2):
        return ["returned something else than (near, far)"]
    return wrong_bounds(*answer, given["rays"])


MISTAKES: dict[str, Callable[[Given, Any], list[str]]] = {
    "nerfreg_needs": lambda _, answers: [line for needs in answers for line in wrong_needs(needs)],
    "nerfreg_layer": _layer,
    "nerfreg_ray_bounds": _ray_bounds,
    "nerfreg_encoder_input": lambda given, answer: wrong_samples(given["samples"], answer),
    "nerfreg_loss": lambda _, answers: [line for terms in answers for line in wrong_terms(terms)],
}
"""Tells the mistakes in what a hook returned, by what it was given."""
