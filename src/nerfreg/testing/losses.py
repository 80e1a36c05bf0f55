"""Plain functions of tensors as plugins, so that both are tested by the same means."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from omegaconf import OmegaConf
from torch import Tensor

from nerfreg.checks.subject import Subject
from nerfreg.errors import NerfregError, nearest
from nerfreg.hooks import Rays, Regularizer, Rendering, Step, hookimpl
from nerfreg.registry.plugins import PluginInfo

Loss = Regularizer | Callable[..., Any]
"""A plugin, or a function that returns a scalar or a dictionary of scalars."""

OF_RENDERING = (*(part.name for part in fields(Rendering)), "alphas", "log_weights", "visible")
OF_RAYS = tuple(part.name for part in fields(Rays))
KNOWN = ("rendering", "step", *OF_RENDERING, *OF_RAYS)
"""The names that an argument of a plain function may have."""


@dataclass
class FunctionLoss(Regularizer):
    """The loss that a plain function computes; a subclass is made for each function."""

    function: ClassVar[Callable[..., Any]]
    arguments: ClassVar[tuple[str, ...]]
    term: ClassVar[str]

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Tensor]:
        """Call the function by what its arguments are named."""
        given = {name: _value(name, rendering, step) for name in self.arguments}
        value = type(self).function(**given)
        return dict(value) if isinstance(value, Mapping) else {self.term: value}


def as_plugin(loss: Loss) -> Regularizer:
    """Return a plugin as it is, and a function as the loss of a plugin.

    Arguments of the function that have a default are left alone.

    Raises:
        NerfregError: An argument of the function has a name that means nothing here.
    """
    if isinstance(loss, Regularizer):
        return loss
    if not callable(loss) or isinstance(loss, type):
        raise NerfregError(f"{loss!r} is neither a plugin nor a function; plugins are instances")
    name = getattr(loss, "__name__", "loss")
    if not name.isidentifier():  # a lambda
        name = "loss"
    arguments = tuple(
        parameter.name
        for parameter in inspect.signature(loss).parameters.values()
        if parameter.default is parameter.empty
        and parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
    )
    for argument in arguments:
        if argument not in KNOWN:
            hint = nearest(argument, KNOWN)
            raise NerfregError(f"{name}(): no rendering has the argument '{argument}'; {hint}")
    parts = {"function": staticmethod(loss), "arguments": arguments, "term": name}
    made: type[Regularizer] = dataclass(type("PlainLoss", (FunctionLoss,), parts))
    return made()


def name_of(plugin: Regularizer) -> str:
    """Return a name for a plugin that nothing has registered: its class in snake case.

    That of a function is the function's own.
    """
    if isinstance(plugin, FunctionLoss):
        return plugin.term
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", type(plugin).__name__).lower()


def subject_of(loss: Loss) -> Subject:
    """Return a loss as what `nerfreg check` drives: with its configuration, but without state.

    Raises:
        NerfregError: It is neither a plugin nor a function, or a function of something unknown.
    """
    plugin = as_plugin(loss)
    info = PluginInfo(name_of(plugin), "", "", type(plugin))
    return Subject(info.name, info.hook_points, OmegaConf.structured(plugin))


def _value(name: str, rendering: Rendering, step: Step) -> Any:
    if name in ("rendering", "step"):
        return rendering if name == "rendering" else step
    return getattr(rendering if name in OF_RENDERING else rendering.rays, name)
