"""The typed node of a plugin's configuration, made of its dataclass."""

from __future__ import annotations

import dataclasses
import re
from enum import Enum, StrEnum
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from omegaconf import DictConfig, OmegaConf, StringNode

from nerfreg.config.nodes import ChoiceNode, NumberNode
from nerfreg.hooks import Regularizer
from nerfreg.registry.plugin_fields import PLUGIN_KEY, schedulable_fields
from nerfreg.scenes.layouts import defaults_of


def plugin_schema(address: str, cls: type[Regularizer]) -> DictConfig:
    """Return a plugin's dataclass as a typed node, with the key by which a saved run finds it.

    Its defaults follow `scene.layout` where the class says so (`Regularizer.by_layout`).

    Args:
        address: What selects the plugin.
        cls: Its class.
    """
    node = typed_node(address, cls)
    defaults = OmegaConf.to_container(node)
    assert isinstance(defaults, dict)

    def by_layout(key: str, *, _root_: DictConfig) -> Any:
        layout = OmegaConf.select(_root_, "scene.layout", default=None)
        return defaults_of(layout, cls.by_layout).get(key, defaults[key])

    resolver = f"{re.sub(r'[^0-9A-Za-z]+', '_', address)}_by_layout"
    OmegaConf.register_new_resolver(resolver, by_layout, replace=True)
    for values in cls.by_layout.values():
        for key in values:
            node[key] = f"${{{resolver}:{key}}}"
    return node


def typed_node(address: str, cls: type[Regularizer]) -> DictConfig:
    """Return the same with the defaults of the class alone."""
    hints = get_type_hints(cls)
    known = {field.name: hints[field.name] for field in dataclasses.fields(cls) if field.init}
    node: DictConfig = OmegaConf.structured(_without_literals(cls, known))
    # The class itself is what the node becomes in the end.
    node._metadata.object_type = cls
    content: dict[str, Any] = node.__dict__["_content"]
    for name, hint in known.items():
        value = content[name]._value()
        if name in schedulable_fields(cls):
            content[name] = NumberNode(value, name)
        elif choices := _choices(hint):
            optional = type(None) in get_args(hint)
            content[name] = ChoiceNode(value, name, choices, optional)
    content[PLUGIN_KEY] = StringNode(address, key=PLUGIN_KEY, is_optional=False)
    for child in content.values():
        child._set_parent(node)
    return node


def field_choices(cls: type[Regularizer], name: str) -> tuple[str, ...]:
    """Return what a field may be, if its type is an enumeration or `Literal`; else nothing."""
    hint = get_type_hints(cls).get(name)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return tuple(hint.__members__)
    return tuple(map(str, _choices(hint)))


def _without_literals(cls: type[Regularizer], hints: dict[str, Any]) -> type:
    """The same class, or one for OmegaConf alone, which does not know `Literal`."""
    plain = {name: Any if _choices(hint) else _plain(hint) for name, hint in hints.items()}
    if plain == hints:
        return cls
    fields = {field.name: field for field in dataclasses.fields(cls)}
    made = [(name, hint, _with_default(fields[name])) for name, hint in plain.items()]
    return dataclasses.make_dataclass(cls.__name__, made)


def _with_default(field: dataclasses.Field[Any]) -> Any:
    return dataclasses.field(
        **{
            key: value
            for key in ("default", "default_factory")
            if (value := getattr(field, key)) is not dataclasses.MISSING
        },
        kw_only=True,
    )


def _choices(hint: Any) -> tuple[Any, ...]:
    """What a field may be that is annotated with `Literal`, or with `Literal[...] | None`."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    some = [part for part in get_args(hint) if part is not type(None)]
    optional = len(some) < len(get_args(hint)) and len(some) == 1
    return get_args(some[0]) if optional and get_origin(some[0]) is Literal else ()


def _plain(hint: Any) -> Any:
    """A type with enumerations in place of the literals in a list or a dictionary."""
    origin, parameters = get_origin(hint), get_args(hint)
    if origin is Literal:
        names = [str(choice) for choice in parameters]
        return StrEnum("Choice", {name: name for name in names})
    if origin in (list, dict) and parameters:
        return origin[tuple(map(_plain, parameters))]
    if origin is not None and type(None) in parameters:
        return Union[tuple(map(_plain, parameters))]  # noqa: UP007
    return hint
