"""Calling plugins: which of them are active, and who is to blame for an error."""

from __future__ import annotations

import math
from functools import cache
from types import FrameType
from typing import Any, TypeVar

import pluggy
from torch import nn

from nerfreg.errors import NerfregError, PluginError
from nerfreg.hooks import ALWAYS_IN_EVALUATION, PROJECT, HookSpecs, Regularizer, Step
from nerfreg.registry.defaults import CoreDefaults
from nerfreg.registry.plugins import HOOKS, conflicts_of, implemented, is_used, origin

T = TypeVar("T")
EDITED = "modified by an inplace operation"
"""What torch says when a tensor of a graph is no longer what it was."""


class PluginCaller:
    """Calls the hooks of the selected plugins.

    Plugins are called in the order in which they were given; a later wrapper goes around an earlier
    one. A plugin of weight 0 is left out altogether, and one outside its window [start, end) is not
    called.

    Attributes:
        plugins: The selected plugins by name.
    """

    def __init__(self, plugins: dict[str, Regularizer] | None = None) -> None:
        self.plugins = dict(plugins or {})
        for name, plugin in self.plugins.items():
            _check(name, plugin, self.plugins)
            # On the instance; the class does not know how often it is selected.
            vars(plugin)["instance"] = name
        used = {name: plugin for name, plugin in self.plugins.items() if is_used(plugin)}
        self._scheduled = [plugin for plugin in used.values() if plugin.schedules]
        self._users = {
            hook: tuple(name for name, plugin in used.items() if hook in implemented(type(plugin)))
            for hook in HOOKS
        }
        # The side of the patches that each plugin asked for last.
        self._patch_sides: dict[str, int] = {}
        self._core = CoreDefaults()
        # Kept, because making a manager is slow against calling it, and there are only as many sets
        # of active plugins as combinations of open windows.
        self._manager = cache(self._make_manager)
        # Made once here, so that a plugin that pluggy refuses is refused before the run begins.
        self._manager(tuple(used))

    def changes(self, hook: str, step: Step) -> bool:
        """Return whether an active plugin implements a hook."""
        return bool(self._active(hook, step))

    def blamed(self, error: Exception, step: Step | None) -> Exception:
        """Return what to raise in place of an error that came up outside of a hook.

        It is a `PluginError` if a layer or module of a plugin raised it, or if a tensor was edited
        that the backward pass needs, which nobody else does. Otherwise it is the error itself.
        """
        if isinstance(error, NerfregError):
            return error
        for frame in _frames(error):
            owner = frame.f_locals.get("self")
            if isinstance(owner, nn.Module) and (name := self.owner(type(owner))):
                what = f"{type(owner).__name__}.{frame.f_code.co_name}"
                return self._error(what, (name,), step, _in_words(error))
        if self.plugins and EDITED in str(error):
            wrong = (
                "a tensor that the gradient needs was edited in place; make a new one, and "
                "change buffers in nerfreg_step_end (train.check=true finds edits of hooks' inputs)"
            )
            return self._error("backward pass", tuple(self.plugins), step, wrong)
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
                hook,
                plugins,
                given.get("step"),
                "returned None; return the answer, as it came or changed",
            )
        return answer

    def _ask_for(
        self, kind: type[T], hook: str, plugins: tuple[str, ...], given: dict[str, Any]
    ) -> T:
        """Call a hook that has a single result, of this type.

        Raises:
            PluginError: The answer is of another type.
        """
        answer = self._ask(hook, plugins, given)
        if not isinstance(answer, kind):
            name = "near and far" if kind is tuple else kind.__name__
            wrong = f"returned {type(answer).__name__}; return {name}"
            raise self._error(hook, plugins, given.get("step"), wrong)
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
    for other in conflicts_of(plugin, plugins):
        raise NerfregError(f"reg={name} cannot be combined with reg={other}; drop one of the two")
