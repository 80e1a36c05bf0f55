"""Fields of a plugin's class that no configuration can hold, and what to write instead."""

from __future__ import annotations

import dataclasses
import enum
import inspect
import types
from collections.abc import Iterator
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from nerfreg.errors import nearest
from nerfreg.hooks import Regularizer
from nerfreg.scenes.layouts import LAYOUTS

PLUGIN_KEY = "plugin"
"""Key of a plugin's configuration that says which plugin it is; no field may have this name."""
PRIMITIVES = (bool, int, float, str, bytes, Path)
INSTEAD = {
    tuple: "list[...]",
    set: "list[...]",
    frozenset: "list[...]",
    complex: "two fields of float",
    object: "Any",
}
"""What to write in place of types that come close."""
TYPO = 0.75
"""Share of letters from which a name is taken for a misspelt `weight`."""


def field_mistake(cls: type[Regularizer]) -> str:
    """Return what is wrong with the fields of a plugin, or nothing."""
    try:
        hints = get_type_hints(cls)
    except NameError as error:
        return (
            f"{cls.__name__}: the type '{error.name}' of a field is not known when the module runs;"
            " import it outside `if TYPE_CHECKING`"
        )
    return (
        _bare_attribute(cls)
        or _own_constructor(cls)
        or next(_wrong_names(cls), "")
        or next(_wrong_types(cls, hints), "")
        or _wrong_class_variables(cls, hints)
    )


def schedulable_fields(cls: type[Regularizer]) -> tuple[str, ...]:
    """Return the fields of a plugin that may be given a schedule."""
    return ("weight", *(name for name in cls.schedulable if name != "weight"))


def _bare_attribute(cls: type[Regularizer]) -> str:
    """An assignment without a type, which `@dataclass` takes for no field."""
    inherited = {field.name for base in cls.__bases__ for field in _fields(base)}
    for name, value in vars(cls).items():
        typed = name in vars(cls).get("__annotations__", {})
        if name in inherited and not typed:
            kind = "float" if name == "weight" else type(value).__name__
            return (
                f"{cls.__name__}.{name} has no type and is ignored; "
                f"write {name}: {kind} = {_shown(value)}"
            )
        if typed or name.startswith("_") or name.isupper() or hasattr(Regularizer, name):
            continue
        if isinstance(value, (*PRIMITIVES, list, dict, tuple, enum.Enum)):
            kind = type(value).__name__
            return (
                f"{cls.__name__}.{name} has no type and is no configuration; "
                f"write {name}: {kind} = {_shown(value)}, or ClassVar[{kind}] if it is none"
            )
    return ""


def _own_constructor(cls: type[Regularizer]) -> str:
    wanted = [field.name for field in dataclasses.fields(cls) if field.init]
    if list(inspect.signature(cls).parameters) == wanted:
        return ""
    return (
        f"{cls.__name__}.__init__ is not the one that @dataclass writes; "
        "declare fields, and do the rest in __post_init__"
    )


def _wrong_names(cls: type[Regularizer]) -> Iterator[str]:
    base = {field.name for field in _fields(Regularizer)}
    for field in dataclasses.fields(cls):
        name = field.name
        if name in base:
            continue
        if name == PLUGIN_KEY:
            yield (
                f"{cls.__name__}.{name} is a field, and the key that says which plugin this is; "
                "give it another name"
            )
        # A property may become a field: `color_inputs: int = 8`.
        elif not isinstance(inspect.getattr_static(Regularizer, name, property()), property):
            yield (
                f"{cls.__name__}.{name} is a field that hides Regularizer.{name}; "
                "give it another name, or no type"
            )
        elif "weight" not in name and SequenceMatcher(None, name.lower(), "weight").ratio() >= TYPO:
            yield (
                f"{cls.__name__}.{name}: the factor of the loss is called 'weight'; "
                "write weight: float = ..."
            )


def _wrong_types(cls: type[Regularizer], hints: dict[str, Any]) -> Iterator[str]:
    if hints["weight"] is not float:
        yield f"{cls.__name__}.weight has type {_named(hints['weight'])}; write weight: float"
    for field in dataclasses.fields(cls):
        if field.name != "weight" and (instead := _instead(hints[field.name])):
            hint = _named(hints[field.name])
            yield (
                f"{cls.__name__}.{field.name} has type {hint}, which no configuration can hold; "
                f"write {instead}"
            )


def _wrong_class_variables(cls: type[Regularizer], hints: dict[str, Any]) -> str:
    names = [field.name for field in dataclasses.fields(cls)]
    for name in cls.schedulable:
        if name not in names:
            hint = nearest(name, names)
            return f"{cls.__name__}.schedulable names '{name}', which is no field; {hint}"
        if hints[name] is not float:
            return (
                f"{cls.__name__}.schedulable names '{name}' of type {_named(hints[name])}; "
                f"only a float can follow a schedule: write {name}: float"
            )
    for layout, defaults in cls.by_layout.items():
        if layout not in LAYOUTS:
            return f"{cls.__name__}.by_layout names '{layout}'; {nearest(layout, LAYOUTS)}"
        for name in defaults:
            if name not in names:
                hint = nearest(name, names)
                return f"{cls.__name__}.by_layout names '{name}', which is no field; {hint}"
    return ""


def _instead(hint: Any) -> str:
    """What to write in place of a type that no configuration can hold; nothing for one that can."""
    origin, parameters = get_origin(hint), get_args(hint)
    kind = origin or hint
    if hint is Any or kind is Literal or kind in PRIMITIVES or kind in (list, dict):
        return next(filter(None, map(_instead, () if kind is Literal else parameters)), "")
    if origin in (Union, types.UnionType):
        some = [part for part in parameters if part is not type(None)]
        # OmegaConf knows unions of primitive types, and None beside any type.
        if len(some) > 1 and not all(part in PRIMITIVES for part in some):
            return " | ".join(_named(part) for part in some if part in PRIMITIVES) or "one type"
        return next(filter(None, map(_instead, some)), "")
    if inspect.isclass(kind) and (issubclass(kind, enum.Enum) or dataclasses.is_dataclass(kind)):
        return ""
    if kind in INSTEAD:
        return INSTEAD[kind]
    module = getattr(kind, "__module__", "")
    if module.startswith(("torch", "numpy")):
        return "numbers or list[float], and make the tensor where it is used"
    if getattr(kind, "__name__", "") == "Callable":
        return "a name, as in Literal['relu', 'gelu'], and look the function up"
    if kind.__module__ == "collections.abc":
        return "dict[str, ...]" if "Mapping" in kind.__name__ else "list[...]"
    return "bool, int, float, str, Path, Literal, an Enum, a dataclass, or a list or dict of these"


def _fields(cls: type) -> tuple[dataclasses.Field[Any], ...]:
    return dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ()


def _named(hint: Any) -> str:
    text = hint.__name__ if inspect.isclass(hint) and not get_args(hint) else str(hint)
    return text.replace("typing.", "").replace("collections.abc.", "")


def _shown(value: object) -> str:
    mutable = isinstance(value, list | dict | set)
    return f"field(default_factory=lambda: {value!r})" if mutable else repr(value)
