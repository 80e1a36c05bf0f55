"""The hooks of one run: the selected plugins, called at each hook point in their order."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import mpmath
import pluggy
from jaxtyping import Float
from torch import Tensor, nn

from nerfreg.errors import NerfregError
from nerfreg.field.layers import Linear
from nerfreg.hooks import (
    PROJECT,
    HookSpecs,
    Needs,
    Rays,
    Regularizer,
    Rendering,
    Samples,
    Step,
    hookimpl,
)
from nerfreg.registry.plugins import HOOKS, implemented
from nerfreg.scenes.scene import Photographs

REFERENCE_DIGITS = 150


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


class CoreDefaults:
    """What happens at each hook point when no plugin is there."""

    @hookimpl(trylast=True)
    def nerfreg_layer(self, in_features: int, out_features: int, activation: str) -> nn.Module:
        """Make a plain linear layer without bias."""
        return Linear(in_features, out_features, activation)

    @hookimpl(trylast=True)
    def nerfreg_ray_bounds(self, rays: Rays) -> tuple[Tensor, Tensor]:
        """Return the bounds that the rays have."""
        return rays.near, rays.far

    @hookimpl(trylast=True)
    def nerfreg_encoder_input(self, samples: Samples) -> Samples:
        """Return the samples as they are."""
        return samples


class Hooks:
    """The hooks of one run.

    Plugins are called in the order in which they were given; a later wrapper goes around an earlier
    one. A plugin of weight 0 is left out altogether, and one outside its window [start, end) is not
    called.

    Args:
        plugins: The selected plugins by name.

    Raises:
        NerfregError: A weight, a window or a combination of plugins cannot work.
    """

    def __init__(self, plugins: dict[str, Regularizer] | None = None) -> None:
        self.plugins = dict(plugins or {})
        for name, plugin in self.plugins.items():
            _check(name, plugin, self.plugins)
        used = {name: plugin for name, plugin in self.plugins.items() if plugin.weight != 0}
        self._users = {
            hook: tuple(name for name, plugin in used.items() if hook in implemented(type(plugin)))
            for hook in HOOKS
        }
        self._core = CoreDefaults()
        # Kept, because making a manager is slow against calling it, and there are only as many sets
        # of active plugins as combinations of open windows.
        self._manager = cache(self._make_manager)
        # Made once here, so that a plugin that pluggy refuses is refused before the run begins.
        self._manager(tuple(used))

    def needs(self, step: Step) -> Needs:
        """Return the union of what the active plugins want rendered."""
        union = Needs()
        for name in self._active("nerfreg_needs", step):
            for needs in self._ask("nerfreg_needs", (name,), {"step": step}):
                union |= needs
        return union

    def layer(
        self, network: str, index: int, in_features: int, out_features: int, activation: str
    ) -> nn.Module:
        """Return one layer of a network, made by a selected plugin whatever its window.

        See `HookSpecs.nerfreg_layer` for the arguments.
        """
        users = self._users["nerfreg_layer"]
        if not users:
            return self._core.nerfreg_layer(in_features, out_features, activation)
        given = {
            "network": network,
            "index": index,
            "in_features": in_features,
            "out_features": out_features,
            "activation": activation,
        }
        layer: nn.Module = self._ask("nerfreg_layer", users, given)
        return layer

    @property
    def depth_tellers(self) -> tuple[str, ...]:
        """Names of the plugins that `known_depth` asks, which may take a while to answer."""
        return self._users["nerfreg_known_depth"]

    def known_depth(self, photographs: Photographs) -> Float[Tensor, "views height width 2"] | None:
        """Return what a selected plugin knows of depth before training, whatever its window.

        Args:
            photographs: The training views.

        Returns:
            An interval of distance for each pixel, NaN where nothing is known; None if no plugin
            answers.

        Raises:
            NerfregError: Two plugins answer, or an answer is not an interval for each pixel.
        """
        known: dict[str, Tensor] = {}
        for name in self.depth_tellers:
            for depth in self._ask("nerfreg_known_depth", (name,), {"photographs": photographs}):
                known[name] = depth
        if len(known) > 1:
            both = " and ".join(known)
            raise NerfregError(
                f"plugins {both} both tell the depth of the photographs; drop one of them"
            )
        for name, depth in known.items():
            shape = (*photographs.images.shape[:3], 2)
            if tuple(depth.shape) != shape:
                found = tuple(depth.shape)
                raise NerfregError(
                    f"plugin {name}, nerfreg_known_depth: has shape {found}, not {shape}"
                )
            if bool((depth[..., 0] > depth[..., 1]).any()):
                raise NerfregError(
                    f"plugin {name}, nerfreg_known_depth: some intervals end before they begin"
                )
        return next(iter(known.values()), None)

    def ray_bounds(self, rays: Rays, step: Step) -> tuple[Tensor, Tensor]:
        """Return near and far of each ray, (R,) each."""
        active = self._active("nerfreg_ray_bounds", step)
        if not active:
            return rays.near, rays.far
        near, far = self._ask("nerfreg_ray_bounds", active, {"rays": rays, "step": step})
        return near, far

    def encoder_input(self, samples: Samples, step: Step) -> Samples:
        """Return what the encoders see in place of `samples`."""
        active = self._active("nerfreg_encoder_input", step)
        if not active:
            return samples
        given = {"samples": samples, "step": step}
        changed: Samples = self._ask("nerfreg_encoder_input", active, given)
        return changed

    def losses(self, rendering: Rendering, step: Step) -> list[Term]:
        """Return all terms of the active plugins, unweighted, each with its plugin's weight.

        Raises:
            NerfregError: A term is not a scalar.
        """
        terms = []
        for name in self._active("nerfreg_loss", step):
            # One plugin at a time, because the answer does not say whose it is.
            given = {"rendering": rendering, "step": step}
            for values in self._ask("nerfreg_loss", (name,), given):
                for term, value in values.items():
                    if value.ndim != 0:
                        shape = tuple(value.shape)
                        raise NerfregError(
                            f"plugin {name}: term '{term}' has shape {shape}, return scalars"
                        )
                    terms.append(Term(name, term, float(self.plugins[name].weight), value))
        return terms

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

    def _ask(self, hook: str, plugins: tuple[str, ...], given: dict[str, Any]) -> Any:
        """Call a hook of these plugins: the one way to them, for a subclass that looks at answers.

        Args:
            hook: Name of the hook.
            plugins: Names of those that take part in the call.
            given: What the hook gets, by the names of its arguments.

        Returns:
            What pluggy returns: a list of answers, or one where the hook has a single result.
        """
        return getattr(self._manager(plugins).hook, hook)(**given)

    def _active(self, hook: str, step: Step) -> tuple[str, ...]:
        users = self._users[hook]
        return tuple(name for name in users if self.plugins[name].active(step)) if users else ()

    def _make_manager(self, names: tuple[str, ...]) -> pluggy.PluginManager:
        # pluggy's own way to call a subset wants hashable plugins, and dataclasses are not.
        manager = pluggy.PluginManager(PROJECT)
        manager.add_hookspecs(HookSpecs)
        manager.register(self._core, "core")
        for name in names:
            try:
                manager.register(self.plugins[name], name)
            except (pluggy.PluginValidationError, ValueError) as error:
                raise NerfregError(f"plugin {name}: {error}".replace("\n", " ")) from error
        return manager


def _check(name: str, plugin: Regularizer, plugins: dict[str, Regularizer]) -> None:
    if not isinstance(plugin, Regularizer):
        raise NerfregError(f"reg.{name}: not a selected plugin; select it by +reg={name}")
    if not (math.isfinite(plugin.weight) and plugin.weight >= 0):
        raise NerfregError(f"reg.{name}.weight={plugin.weight}: must be finite and not negative")
    for key in ("start", "end"):
        value = getattr(plugin, key)
        if value < 0 or (isinstance(value, float) and not value <= 1):
            raise NerfregError(
                f"reg.{name}.{key}={value}: must be a step (an integer from 0) "
                "or a fraction of the budget (0.0 to 1.0)"
            )
    if type(plugin.start) is type(plugin.end) and plugin.start >= plugin.end:
        raise NerfregError(
            f"reg.{name}.start={plugin.start}: must be before reg.{name}.end={plugin.end}"
        )
    for other in plugin.conflicts:
        if other in plugins:
            raise NerfregError(
                f"reg={name} cannot be combined with reg={other}; drop one of the two"
            )
