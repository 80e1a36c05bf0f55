"""What the author of a plugin may have got wrong, in one line that says what to write instead."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import Any

from nerfreg.errors import nearest
from nerfreg.hooks import (
    CHANGED,
    HOOKS_VERSION,
    IN_EVALUATION_IF_ASKED,
    PROJECT,
    HookSpecs,
    Regularizer,
)
from nerfreg.registry.plugin_fields import field_mistake

ARGUMENTS = {
    name: tuple(inspect.signature(spec).parameters)[1:]
    for name, spec in vars(HookSpecs).items()
    if name.startswith("nerfreg_")
}
"""The arguments of each hook, `self` left out."""
TUPLES = ("conflicts", "schedulable", "in_evaluation")
"""Class variables of `Regularizer` that hold names."""


def import_mistake(error: Exception) -> str:
    """Return why a plugin's module cannot be imported; what `@dataclass` refuses, as what to do."""
    text = str(error).partition("\n")[0]
    if match := re.search(r"mutable default <class '(\w+)'> for field (\w+) is not allowed", text):
        kind, name = match.groups()
        return (
            f"the default of '{name}' is a {kind}, which all instances would share; "
            f"write {name}: {kind}[...] = field(default_factory={kind})"
        )
    if match := re.search(r"non-default argument '(\w+)' follows default argument", text):
        return (
            f"'{match[1]}' has no default, and every field that follows weight needs one; "
            f"write {match[1]}: float = ..."
        )
    return f"failed to import: {type(error).__name__}: {text}"


def mistake_of(cls: object) -> str:
    """Return what keeps the object behind an entry point from being a plugin, or nothing."""
    if isinstance(cls, Regularizer):
        name = type(cls).__name__
        return f"the entry point names an instance of {name}; name the class, as in 'module:{name}'"
    if inspect.ismodule(cls):
        return f"the entry point names a module; name the class, as in '{cls.__name__}:ClassName'"
    if not (isinstance(cls, type) and issubclass(cls, Regularizer)):
        return f"{cls!r} does not derive from nerfreg.Regularizer"
    if "__dataclass_params__" not in vars(cls):
        return f"class {cls.__name__} is not decorated with @dataclass; write it above the class"
    return _names_mistake(cls) or _hooks_mistake(cls) or field_mistake(cls) or _version_mistake(cls)


def _names_mistake(cls: type[Regularizer]) -> str:
    for key in TUPLES:
        value = getattr(cls, key)
        if isinstance(value, str):
            return f"{cls.__name__}.{key} is a string; write {key} = ('{value}',)"
    for name in cls.in_evaluation:
        if name not in IN_EVALUATION_IF_ASKED:
            hint = nearest(name, IN_EVALUATION_IF_ASKED)
            return f"{cls.__name__}.in_evaluation names '{name}', not called in evaluation; {hint}"
        if not _is_hook(getattr(cls, name, None)):
            return f"{cls.__name__}.in_evaluation names '{name}', which the class does not have"
    gives, counts = _is_hook(getattr(cls, "nerfreg_color_input", None)), _has_color_inputs(cls)
    if gives and not counts:
        return (
            f"{cls.__name__}.nerfreg_color_input: the class does not say how many inputs it gives; "
            "write a property color_inputs"
        )
    if counts and not gives:
        return f"{cls.__name__}.color_inputs: the class has no nerfreg_color_input that gives them"
    return ""


def _hooks_mistake(cls: type[Regularizer]) -> str:
    for name in dir(cls):
        function = getattr(cls, name, None)
        if (_is_hook(function) or name.startswith("nerfreg_")) and name not in ARGUMENTS:
            return f"{cls.__name__}.{name} is not a hook; {nearest(name, ARGUMENTS)}"
        if name not in ARGUMENTS:
            continue
        if not _is_hook(function):
            return f"{cls.__name__}.{name} is not decorated with @hookimpl; write it above the name"
        assert callable(function)
        if wrong := _kind_mistake(function) or _arguments_mistake(name, function):
            return f"{cls.__name__}.{name} {wrong}"
    return ""


def _kind_mistake(function: Callable[..., Any]) -> str:
    options = getattr(function, f"{PROJECT}_impl")
    wraps = options.get("wrapper") or options.get("hookwrapper")
    if inspect.iscoroutinefunction(function) or inspect.isasyncgenfunction(function):
        return "is asynchronous; write def in place of async def"
    if inspect.isgeneratorfunction(function) and not wraps:
        return "has a yield, so that it is a wrapper; write @hookimpl(wrapper=True)"
    if wraps and not inspect.isgeneratorfunction(function):
        return "is a wrapper without a yield; write `answer = yield` and return the new answer"
    return ""


def _arguments_mistake(name: str, function: Callable[..., Any]) -> str:
    known = ARGUMENTS[name]
    given = inspect.signature(function).parameters
    listed = f"its arguments are {', '.join(known)}"
    first = next(iter(given), None)
    if first is None or first in known:
        return f"has no self; write def {name}({', '.join(['self', *given])})"
    for argument, parameter in list(given.items())[1:]:
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            return f"takes {parameter}, which is always empty; {listed}"
        if argument not in known:
            return f"has an argument '{argument}'; {nearest(argument, known)} ({listed})"
        # pluggy passes no argument that could be left out.
        if parameter.default is not parameter.empty:
            return f"gives '{argument}' a default and would get nothing else; write {argument}"
        if parameter.kind is parameter.KEYWORD_ONLY:
            return f"takes '{argument}' by keyword alone; leave out the *"
    return ""


def _version_mistake(cls: type[Regularizer]) -> str:
    versions = cls.hook_versions
    if versions is None:
        return ""
    pair = isinstance(versions, tuple) and len(versions) == 2
    if not pair or not all(type(v) is int for v in versions) or versions[0] > versions[1]:
        return (
            f"{cls.__name__}.hook_versions={versions}: must be the first and the last version, "
            f"as in ({HOOKS_VERSION}, {HOOKS_VERSION})"
        )
    first, last = versions
    if first > HOOKS_VERSION:
        return f"needs hooks version {first}, this nerfreg has {HOOKS_VERSION}: upgrade nerfreg"
    changed = [
        f"{hook} (version {version})"
        for version, hooks in sorted(CHANGED.items())
        for hook in hooks
        if version > last and _is_hook(getattr(cls, hook, None))
    ]
    if not changed:
        return ""
    return (
        f"was written for hooks version {last}, and what it implements has changed since: "
        f"{', '.join(changed)}; read their specification and set hook_versions"
    )


def _is_hook(function: object) -> bool:
    return hasattr(function, f"{PROJECT}_impl")


def _has_color_inputs(cls: type[Regularizer]) -> bool:
    return inspect.getattr_static(cls, "color_inputs") is not vars(Regularizer)["color_inputs"]
