"""Tables of the fields of a configuration dataclass."""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Mapping
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from nerfreg_docs.docstrings import attributes
from nerfreg_docs.markdown import code, plain, table

HEAD = ("key", "type", "default", "meaning")


def fields_table(
    prefix: str,
    cls: type,
    values: Mapping[str, Any] | None = None,
    by_layout: Mapping[str, Mapping[str, Any]] | None = None,
    only: frozenset[str] | None = None,
) -> str:
    """The fields of a dataclass as a table of key, type, default and meaning.

    Args:
        prefix: What stands before the name of a field in a key, such as "train.".
        cls: The dataclass; its `Attributes:` and those of its bases tell the meaning.
        values: Defaults that a file of `conf` sets, where they differ from the class.
        by_layout: Defaults by kind of capture.
        only: Names of the fields to list; None lists all.
    """
    meanings, hints = attributes(cls), get_type_hints(cls)
    rows = [
        [
            code(prefix + field.name),
            type_name(hints[field.name]),
            default_text(field, values or {}, by_layout or {}),
            plain(meanings.get(field.name, "")),
        ]
        for field in dataclasses.fields(cls)
        if only is None or field.name in only
    ]
    return table(HEAD, rows)


def type_name(hint: Any) -> str:
    """A type as users of YAML call it."""
    if hint is type(None):
        return "null"
    if hint is Any:
        return "any"
    origin, parameters = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return " or ".join(map(type_name, parameters))
    if origin is Literal:
        return " or ".join(map(yaml_value, parameters))
    if origin is list or hint is list:
        named = parameters and parameters[0] is not Any
        return f"list of {type_name(parameters[0])}" if named else "list"
    if origin is dict or hint is dict:
        return f"map to {type_name(parameters[1])}" if parameters else "map"
    name: str = hint.__name__
    return {"str": "string"}.get(name, name)


def default_text(
    field: dataclasses.Field[Any],
    values: Mapping[str, Any],
    by_layout: Mapping[str, Mapping[str, Any]],
) -> str:
    """The default of a field, followed by what it is for kinds of capture that differ."""
    parts = [code(yaml_value(values.get(field.name, _default(field))))]
    for layout, defaults in by_layout.items():
        if field.name in defaults:
            parts.append(f"{layout}: {code(yaml_value(defaults[field.name]))}")
    return "; ".join(parts)


def yaml_value(value: Any) -> str:
    """A value as it is typed in an override or a YAML file."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(yaml_value, value))}]"
    return str(value)


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default
