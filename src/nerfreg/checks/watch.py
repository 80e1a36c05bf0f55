"""Hooks that note what a plugin does wrong besides its results, and go on."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from nerfreg.field.layers import Linear
from nerfreg.hooks import Regularizer, Step
from nerfreg.registry.plugins import HOOKS
from nerfreg.training.checked_hooks import CheckedHooks

BUILDING = ("nerfreg_encoder", "nerfreg_layer", "nerfreg_module")
"""Hooks that may draw from torch's global generator, which the run seeds, to initialize weights."""

GENERATORS = {
    "torch": "torch's global generator",
    "numpy": "numpy's global generator",
    "python": "Python's module random",
}
DUE = {
    "nerfreg_rays": "rays",
    "nerfreg_ray_bounds": "(near, far)",
    "nerfreg_occupancy": "an OccupancyGrid",
    "nerfreg_empty": "booleans (P,)",
    "nerfreg_encoder_input": "samples",
    "nerfreg_density": "densities (R, N)",
    "nerfreg_color_input": "features (K, color_inputs)",
    "nerfreg_rendering": "a rendering",
}
"""Hooks without any effect if they return None, and what to return."""

FOUND_OUT = ("nerfreg_occupancy",)
"""Those whose answers come from photographs, and need some that are more than made up."""


@dataclass(frozen=True)
class Surroundings:
    """What a hook must leave as it is.

    Attributes:
        generators: States of the global generators, by `GENERATORS`.
        settings: Torch's global settings, by name.
        weights: Values of the field's weights, by name.
        graded: Which of them have a gradient.
    """

    generators: Mapping[str, Any]
    settings: Mapping[str, Any]
    weights: Mapping[str, Tensor]
    graded: frozenset[str]

    @classmethod
    def now(cls, weights: Mapping[str, Tensor]) -> Surroundings:
        """Return what is the case now."""
        of_numpy: Any = np.random.get_state()
        return cls(
            generators={
                "torch": torch.get_rng_state().numpy().tobytes(),
                "numpy": (np.asarray(of_numpy[1]).tobytes(), of_numpy[2:]),
                "python": random.getstate(),
            },
            settings={
                "default dtype": torch.get_default_dtype(),
                "number of threads": torch.get_num_threads(),
                "anomaly detection": torch.is_anomaly_enabled(),
                "deterministic mode": torch.are_deterministic_algorithms_enabled(),
            },
            weights={name: weight.detach().clone() for name, weight in weights.items()},
            graded=frozenset(name for name, weight in weights.items() if weight.grad is not None),
        )

    def changes(self, before: Surroundings, hook: str) -> Iterator[str]:
        """Yield a line for everything that is not as it was before."""
        building = hook in BUILDING
        instead = "use step.generator"
        if hook == "nerfreg_unseen_poses":
            instead = "use the generator that it gets"
        elif building:
            instead = "use torch's, which the run seeds"
        elif hook in ("nerfreg_prepare", "nerfreg_known_depth"):
            instead = "use a torch.Generator().manual_seed(0) of its own"
        for name, words in GENERATORS.items():
            drawn = self.generators[name] != before.generators[name]
            if drawn and not (building and name == "torch"):
                yield f"{hook} draws from {words}, or seeds it; {instead}"
        for name, value in before.settings.items():
            if self.settings[name] != value:
                yield f"{hook} changes torch's global setting: {name}"
        for name, weight in before.weights.items():
            if not torch.equal(self.weights[name], weight):
                yield f"{hook} changes weights of the field: {name}; return a term that moves them"
        if more := self.graded - before.graded:
            yield (
                f"{hook} adds to the gradient of the field's weights: {min(more)}; "
                "return the term and leave its backward pass to the core"
            )


class WatchedHooks(CheckedHooks):
    """Hooks of one plugin that collect faults where `CheckedHooks` raises them.

    Attributes:
        faults: By check ("contract" or "effects"), what was found, once each.
        weights: Weights that no hook may change, by name; set by whoever builds the field.
    """

    def __init__(self, plugins: dict[str, Regularizer] | None = None) -> None:
        self.faults: dict[str, dict[str, None]] = {"contract": {}, "effects": {}}
        self.weights: Mapping[str, Tensor] = {}
        self._answered: dict[str, list[bool]] = {}
        self._running: list[str] = []
        self._before = Surroundings.now({})
        super().__init__(plugins)

    def fallen_silent(self, hooks: Iterable[str]) -> list[str]:
        """Return a line for each of some hooks that was called and returned nothing but None."""
        return [
            f"{hook} returned None each time, which has no effect; return {DUE[hook]}"
            for hook in hooks
            if hook in self._answered and not any(self._answered[hook])
        ]

    def take(self, check: str) -> list[str]:
        """Return the faults of a check, and forget them."""
        lines = list(self.faults[check])
        self.faults[check] = {}
        return lines

    def _ask(self, hook: str, plugins: tuple[str, ...], given: dict[str, Any]) -> Any:
        step = given.get("step")
        if threading.current_thread() is not threading.main_thread():
            # Views are rendered by several threads, and one cannot tell what another changes.
            return super()._ask(hook, plugins, given)
        with self._watched(hook), _seeded(step, hook, self.faults["effects"]):
            return super()._ask(hook, plugins, given)

    @contextmanager
    def _watched(self, hook: str) -> Iterator[None]:
        # A hook may render again, and so call another one. What changes meanwhile is due to the
        # innermost hook that is running; nobody watches what the core does between two hooks.
        self._settle()
        self._running.append(hook)
        try:
            yield
        finally:
            self._settle()
            self._running.pop()

    def _settle(self) -> None:
        now = Surroundings.now(self.weights)
        if self._running and now.weights.keys() == self._before.weights.keys():
            lines = now.changes(self._before, self._running[-1])
            self.faults["effects"].update(dict.fromkeys(lines))
        self._before = now

    def _refuse(
        self, hook: str, plugins: tuple[str, ...], step: Step | None, wrong: list[str]
    ) -> None:
        for line in wrong:
            check = "effects" if " has been " in line else "contract"
            self.faults[check][f"{hook}: {line}"] = None

    def _make_manager(self, names: tuple[str, ...]) -> Any:
        manager = super()._make_manager(names)
        for hook in DUE:
            for made in getattr(manager.hook, hook).get_hookimpls():
                # A wrapper's None would be the answer itself, which the core refuses.
                if made.plugin_name in names and not (made.wrapper or made.hookwrapper):
                    function = "function"  # a constant to type checkers
                    setattr(made, function, self._recorded(hook, made.function))
        return manager

    def _recorded(self, hook: str, function: Callable[..., Any]) -> Callable[..., Any]:
        # Of all implementations of a hook pluggy takes the first answer that is not None, so that
        # the last of them, the core's, hides a None.
        def call(*given: Any) -> Any:
            answer = function(*given)
            self._answered.setdefault(hook, []).append(answer is not None)
            return answer

        return call


@contextmanager
def _seeded(step: Step | None, hook: str, faults: dict[str, None]) -> Iterator[None]:
    """Note if the step's generator is seeded, which would repeat the numbers of other steps."""
    seed = step.generator.initial_seed() if step else None
    yield
    if step and step.generator.initial_seed() != seed:
        faults[f"{hook} seeds step.generator; draw from it, and leave its state alone"] = None


def core_weights(parts: Iterable[tuple[str, nn.Module | nn.Parameter]]) -> dict[str, Tensor]:
    """Return the weights of a field that belong to no plugin.

    Args:
        parts: Parts of the field by name; of modules, those layers count that the core made.
    """
    weights: dict[str, Tensor] = {}
    for name, part in parts:
        if isinstance(part, nn.Parameter):
            weights[name] = part
            continue
        for inner, module in part.named_modules():
            # Around those that the core made, a plugin may have put its own.
            if type(module) is Linear:
                weights[f"{name}.{inner}.weight"] = module.weight
    return weights


assert set(DUE) <= set(HOOKS)
