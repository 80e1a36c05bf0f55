"""The hooks of one run: the selected plugins, called at each hook point in their order."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import fields
from typing import Any

import mpmath
from torch import nn

from nerfreg.hooks import Rays, Regularizer, Rendering, Samples, Step
from nerfreg.registry.building import BuildingHooks
from nerfreg.registry.plugins import with_changes
from nerfreg.registry.preparing import PreparingHooks
from nerfreg.registry.stepping import SteppingHooks

REFERENCE_DIGITS = 150


class Hooks(BuildingHooks, PreparingHooks, SteppingHooks):
    """All hooks of one run, with the state of its plugins."""

    def state_dict(self) -> dict[str, dict[str, Any]]:
        """Return the state of all plugins that have any, by name."""
        states = {name: plugin.state_dict() for name, plugin in self.plugins.items()}
        return {name: state for name, state in states.items() if state}

    def load_state_dict(self, states: Mapping[str, dict[str, Any]]) -> None:
        """Restore the state of plugins."""
        for name, state in states.items():
            if name in self.plugins:
                self.plugins[name].load_state_dict(state)

    def fresh(self) -> Hooks:
        """Return the hooks of another run with the same configuration."""
        return Hooks({name: _anew(plugin) for name, plugin in self.plugins.items()})

    def with_plugin(self, name: str, plugin: Regularizer) -> Hooks:
        """Return hooks in which another plugin has the place of the one of that name."""
        return Hooks({**self.plugins, name: plugin})

    def reference(
        self, name: str, given: nn.Module | Rays | Samples | Rendering, step: Step
    ) -> dict[str, Any]:
        """Return the exact values of what plugin `name` makes of `given`; empty if it has none."""
        with mpmath.workdps(REFERENCE_DIGITS):
            answers = self._ask("nerfreg_reference", (name,), {"given": given, "step": step})
        return {key: value for answer in answers for key, value in answer.items()}

    def contract(self, name: str, step: Step) -> dict[str, float]:
        """Return by how much plugin `name` breaks each promise that it makes of itself."""
        answers = self._ask("nerfreg_contract", (name,), {"step": step})
        return {key: value for answer in answers for key, value in answer.items()}


def _anew(plugin: Regularizer) -> Regularizer:
    """A plugin with the same configuration that has taken part in nothing yet."""
    values = {part.name: getattr(plugin, part.name) for part in fields(plugin) if part.init}
    return with_changes(plugin, **deepcopy(values))
