"""The hooks of one run: the selected plugins, called at each hook point in their order."""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, fields
from functools import cache
from types import FrameType
from typing import Any

import mpmath
import pluggy
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from nerfreg.errors import NerfregError, PluginError
from nerfreg.field.layers import Linear
from nerfreg.hooks import (
    ALWAYS_IN_EVALUATION,
    PROJECT,
    ColorSamples,
    DensitySamples,
    EvaluatedView,
    HookSpecs,
    Needs,
    Rays,
    Regularizer,
    Rendering,
    Samples,
    Step,
    TrainedModule,
    hookimpl,
)
from nerfreg.registry.plugins import HOOKS, implemented, origin
from nerfreg.scenes.scene import Photographs, SceneInfo

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
    def nerfreg_rays(self, rays: Rays) -> Rays:
        """Return the rays as they are."""
        return rays

    @hookimpl(trylast=True)
    def nerfreg_encoder_input(self, samples: Samples) -> Samples:
        """Return the samples as they are."""
        return samples

    @hookimpl(trylast=True)
    def nerfreg_density(self, samples: DensitySamples) -> Tensor:
        """Return the densities as they are."""
        return samples.density

    @hookimpl(trylast=True)
    def nerfreg_rendering(self, rendering: Rendering) -> Rendering:
        """Return the rendering as it is."""
        return rendering


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
        used = {
            name: plugin
            for name, plugin in self.plugins.items()
            if plugin.weight != 0 or "weight" in plugin.schedules
        }
        self._scheduled = [plugin for plugin in used.values() if plugin.schedules]
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

    def begin(self, step: Step) -> None:
        """Set all fields that have a schedule to their values in this step."""
        for plugin in self._scheduled:
            plugin.follow_schedules(step)

    def encoder(self, which: str, scene: SceneInfo) -> nn.Module | None:
        """Return the encoder of a selected plugin, of "positions" or "directions", or None.

        Raises:
            PluginError: The encoder does not tell its width.
        """
        users = self._users["nerfreg_encoder"]
        if not users:
            return None
        given = {"which": which, "scene_info": scene}
        encoder: nn.Module | None = self._ask("nerfreg_encoder", users, given)
        if encoder is not None and not isinstance(getattr(encoder, "width", None), int):
            raise self._error(
                "nerfreg_encoder",
                users,
                None,
                f"the encoder of {which} has no attribute 'width'; set it to the number of its "
                "features, an integer",
            )
        return encoder

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
    def color_inputs(self) -> int:
        """How many inputs of the colour network come from plugins."""
        return sum(self.plugins[name].color_inputs for name in self._users["nerfreg_color_input"])

    def modules(self, scene: SceneInfo) -> dict[str, TrainedModule]:
        """Return the modules of the selected plugins, by the names of the plugins.

        Raises:
            PluginError: A plugin returned something else.
        """
        made = {}
        for name in self._users["nerfreg_module"]:
            for part in self._ask("nerfreg_module", (name,), {"scene_info": scene}):
                module = part.module if isinstance(part, TrainedModule) else part
                if not isinstance(module, nn.Module):
                    kind = f"returned {type(module).__name__}; return a torch module"
                    raise self._error("nerfreg_module", (name,), None, kind)
                made[name] = part if isinstance(part, TrainedModule) else TrainedModule(part)
        return made

    @property
    def preparing(self) -> tuple[str, ...]:
        """Names of the plugins that look at the photographs first, which may take a while."""
        hooks = ("nerfreg_prepare", "nerfreg_known_depth")
        return tuple(dict.fromkeys(name for hook in hooks for name in self._users[hook]))

    def prepare(self, photographs: Photographs) -> dict[str, Tensor]:
        """Return what the selected plugins know of each training pixel, by "plugin.name".

        Each has a value, or several, for each pixel: (V, H, W, ...).

        Args:
            photographs: The training views.

        Raises:
            PluginError: An answer has no value for each pixel.
        """
        data = {}
        size = tuple(photographs.images.shape[:3])
        for plugin in self._users["nerfreg_prepare"]:
            for answer in self._ask("nerfreg_prepare", (plugin,), {"photographs": photographs}):
                for name, values in answer.items():
                    if not isinstance(values, Tensor) or tuple(values.shape[:3]) != size:
                        found = (
                            f"shape {tuple(values.shape)}"
                            if isinstance(values, Tensor)
                            else type(values).__name__
                        )
                        raise self._error(
                            "nerfreg_prepare",
                            (plugin,),
                            None,
                            f"'{name}' is {found}; return a tensor of {size} and more axes",
                        )
                    data[f"{plugin}.{name}"] = values
        return data

    def known_depth(self, photographs: Photographs) -> Float[Tensor, "views height width 2"] | None:
        """Return what the selected plugins know of depth before training, whatever their windows.

        Args:
            photographs: The training views.

        Returns:
            An interval of distance for each pixel, NaN where nothing is known; None if no plugin
            answers. Of several plugins, it is the intersection of their intervals, or the narrower
            interval where these have nothing in common.

        Raises:
            PluginError: An answer is not an interval for each pixel.
        """
        known: Tensor | None = None
        for name in self._users["nerfreg_known_depth"]:
            for depth in self._ask("nerfreg_known_depth", (name,), {"photographs": photographs}):
                shape = (*photographs.images.shape[:3], 2)
                wrong = ""
                if tuple(depth.shape) != shape:
                    wrong = f"has shape {tuple(depth.shape)}, not {shape}"
                elif bool((depth[..., 0] > depth[..., 1]).any()):
                    wrong = "some intervals end before they begin"
                if wrong:
                    raise self._error("nerfreg_known_depth", (name,), None, wrong)
                known = depth if known is None else _agreed(known, depth)
        return known

    def start(self, step: Step) -> None:
        """Tell the selected plugins that the first step is about to be made."""
        self._tell("nerfreg_start", self._users["nerfreg_start"], step)

    def step_end(self, step: Step) -> None:
        """Tell the active plugins that a step has been made."""
        self._tell("nerfreg_step_end", self._active("nerfreg_step_end", step), step)

    def end(self, step: Step) -> None:
        """Tell the selected plugins that the last step has been made."""
        self._tell("nerfreg_end", self._users["nerfreg_end"], step)

    def needs(self, step: Step) -> Needs:
        """Return the union of what the active plugins want rendered."""
        union = Needs()
        for name in self._active("nerfreg_needs", step):
            for needs in self._ask("nerfreg_needs", (name,), {"step": step}):
                union |= needs
        return union

    def unseen_poses(
        self, step: Step, scene: SceneInfo, count: int
    ) -> tuple[Float[Tensor, "count 3 4"], Int[Tensor, " count"]] | None:
        """Return poses of unseen cameras, and the training views whose intrinsics they have.

        Args:
            step: Where the run stands.
            scene: What is known of the scene.
            count: How many poses are needed.

        Returns:
            None if no active plugin chooses them.

        Raises:
            PluginError: An answer is not as many poses as were asked for.
        """
        active = self._active("nerfreg_unseen_poses", step)
        parts = []
        for place, name in enumerate(active):
            # Equal parts, of which the first ones take what is left over.
            share = len(range(place, count, len(active)))
            given = {"scene_info": scene, "count": share, "generator": step.generator}
            for answer in self._ask("nerfreg_unseen_poses", (name,), given):
                poses, views = answer if isinstance(answer, tuple) else (answer, None)
                if tuple(poses.shape) != (share, 3, 4):
                    wrong = f"returned poses of shape {tuple(poses.shape)}, not {(share, 3, 4)}"
                    raise self._error("nerfreg_unseen_poses", (name,), step, wrong)
                if views is None:
                    cameras = len(scene.cameras)
                    views = torch.randint(cameras, (share,), generator=step.generator)
                parts.append((poses, views))
        if not parts:
            return None
        poses, views = (torch.cat(column) for column in zip(*parts, strict=True))
        return poses, views

    def rays(self, rays: Rays, step: Step) -> Rays:
        """Return the rays as the plugins change them."""
        active = self._active("nerfreg_rays", step)
        if not active:
            return rays
        changed: Rays = self._ask("nerfreg_rays", active, {"rays": rays, "step": step})
        return changed

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

    def empty(
        self, positions: Float[Tensor, "points 3"], step: Step
    ) -> Bool[Tensor, " points"] | None:
        """Return which positions are declared empty; None if no plugin declares any.

        Raises:
            PluginError: An answer does not have a truth value for each position.
        """
        empty: Tensor | None = None
        for name in self._active("nerfreg_empty", step):
            given = {"positions": positions, "step": step}
            for answer in self._ask("nerfreg_empty", (name,), given):
                if answer.dtype != torch.bool or answer.shape != positions.shape[:1]:
                    found = f"{answer.dtype} {tuple(answer.shape)}"
                    wrong = f"returned {found}; return booleans ({len(positions)},)"
                    raise self._error("nerfreg_empty", (name,), step, wrong)
                empty = answer if empty is None else empty | answer
        return empty

    def changes(self, hook: str, step: Step) -> bool:
        """Return whether an active plugin implements a hook."""
        return bool(self._users[hook]) and bool(self._active(hook, step))

    def density(self, samples: DensitySamples, step: Step) -> Float[Tensor, "rays samples"]:
        """Return the densities as the plugins change them."""
        active = self._active("nerfreg_density", step)
        if not active:
            return samples.density
        given = {"samples": samples, "step": step}
        density: Tensor = self._ask("nerfreg_density", active, given)
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
        changed: Rendering = self._ask("nerfreg_rendering", active, given)
        return changed

    def losses(self, rendering: Rendering, step: Step) -> list[Term]:
        """Return all terms of the active plugins, unweighted, each with its plugin's weight.

        Raises:
            PluginError: A term is not a scalar tensor, or there is no dictionary of terms.
        """
        terms = []
        for name in self._active("nerfreg_loss", step):
            # One plugin at a time, because the answer does not say whose it is.
            given = {"rendering": rendering, "step": step}
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

    def metrics(self, view: EvaluatedView, step: Step) -> dict[str, float]:
        """Return what the selected plugins measure of a view, by "plugin.metric"."""
        found: dict[str, float] = {}
        for name in self._users["nerfreg_metrics"]:
            for values in self._ask("nerfreg_metrics", (name,), {"view": view, "step": step}):
                found |= {f"{name}.{metric}": float(value) for metric, value in values.items()}
        return found

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

    def blamed(self, error: Exception, step: Step | None) -> Exception:
        """Return what to raise in place of an error that came up outside of a hook.

        It is a `PluginError` if a layer or module of a plugin raised it, else the error itself.
        """
        if isinstance(error, NerfregError):
            return error
        for frame in _frames(error):
            owner = frame.f_locals.get("self")
            if isinstance(owner, nn.Module) and (name := self.owner(type(owner))):
                what = f"{type(owner).__name__}.{frame.f_code.co_name}"
                return self._error(what, (name,), step, _in_words(error))
        return error

    def owner(self, cls: type) -> str | None:
        """Return the name of the plugin in whose module, or package, a class is defined.

        Of several plugins there, one that makes modules is preferred.
        """
        makers = ("nerfreg_layer", "nerfreg_encoder", "nerfreg_module")
        by_preference = sorted(
            self.plugins, key=lambda name: not any(name in self._users[hook] for hook in makers)
        )
        # A package may lie in several modules, but all built-in plugins share one.
        for depth in (None, 1):
            for name in by_preference:
                place = type(self.plugins[name]).__module__.split(".")[:depth]
                if place == cls.__module__.split(".")[:depth] and place != ["nerfreg_plugins"]:
                    return name
        return None

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
        try:
            answer = getattr(self._manager(plugins).hook, hook)(**given)
        except NerfregError:
            raise
        except Exception as error:  # a foreign plugin may raise anything
            # Of several plugins it is the one whose code was running.
            running = [
                name
                for frame in _frames(error)
                for name in plugins
                if frame.f_locals.get("self") is self.plugins[name]
            ]
            names = tuple(running[:1]) or plugins
            raise self._error(hook, names, given.get("step"), _in_words(error)) from error
        if answer is None and hook != "nerfreg_encoder":
            raise self._error(
                hook, plugins, given.get("step"), "returned None; return what it specifies"
            )
        return answer

    def _tell(self, hook: str, plugins: tuple[str, ...], step: Step) -> None:
        if plugins:
            self._ask(hook, plugins, {"step": step})

    def _error(
        self, hook: str, plugins: tuple[str, ...], step: Step | None, wrong: str
    ) -> PluginError:
        who = ", ".join(f"{name} ({origin(type(self.plugins[name]))})" for name in plugins)
        when = "" if step is None else f" at step {step.index}"
        return PluginError(f"plugin{'s' if len(plugins) > 1 else ''} {who}, {hook}{when}: {wrong}")

    def _active(self, hook: str, step: Step) -> tuple[str, ...]:
        users = self._users[hook]
        if not users:
            return users
        return tuple(
            name
            for name in users
            if (plugin := self.plugins[name]).weight != 0
            and plugin.active(step)
            and (step.training or hook in ALWAYS_IN_EVALUATION or hook in plugin.in_evaluation)
        )

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


def _agreed(
    a: Float[Tensor, "*pixels 2"], b: Float[Tensor, "*pixels 2"]
) -> Float[Tensor, "*pixels 2"]:
    """Intersect intervals; take the narrower one where there is no intersection, or one is NaN."""
    # `fmax` and `fmin` ignore NaN.
    both = torch.stack([torch.fmax(a[..., 0], b[..., 0]), torch.fmin(a[..., 1], b[..., 1])], dim=-1)
    narrower = torch.where(a.diff(dim=-1) <= b.diff(dim=-1), a, b)
    return torch.where(both[..., :1] <= both[..., 1:], both, narrower)


def _anew(plugin: Regularizer) -> Regularizer:
    """A plugin with the same configuration that has taken part in nothing yet."""
    values = {part.name: getattr(plugin, part.name) for part in fields(plugin) if part.init}
    fresh: Regularizer = type(plugin)(**deepcopy(values))
    if plugin.schedules:
        # On the instance, where the configuration puts it.
        vars(fresh)["schedules"] = plugin.schedules
    return fresh


def _frames(error: BaseException) -> list[FrameType]:
    """The frames that were running when an error was raised, the innermost first."""
    frames, trace = [], error.__traceback__
    while trace is not None:
        frames.append(trace.tb_frame)
        trace = trace.tb_next
    return frames[::-1]


def _in_words(error: Exception) -> str:
    line = f"{type(error).__name__}: {error}".partition("\n")[0]
    return f"{line} (--debug shows the traceback)"


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
