"""What Google docstrings say of a class and its fields."""

from __future__ import annotations

import inspect
import re

SECTION = re.compile(r"^[A-Z][A-Za-z ]*:$")
ITEM = re.compile(r"^ {4}(\w+)(?: \([^)]*\))?: ?(.*)$")


def summary(thing: object) -> str:
    """The first paragraph of a docstring, in one line."""
    paragraph = inspect.cleandoc(getattr(thing, "__doc__", None) or "").partition("\n\n")[0]
    return " ".join(paragraph.split())


def attributes(cls: type) -> dict[str, str]:
    """The items of the `Attributes:` sections of a class and its bases, in one line each.

    What a class says of a field replaces what its bases say.
    """
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        found |= section(inspect.cleandoc(base.__dict__.get("__doc__") or ""), "Attributes")
    return found


def section(docstring: str, name: str) -> dict[str, str]:
    """The items of one section of a docstring whose common indentation is removed."""
    items: dict[str, str] = {}
    inside, item = False, ""
    for line in docstring.splitlines():
        if SECTION.match(line):
            inside, item = line == f"{name}:", ""
        elif line and not line.startswith(" "):
            inside = False
        elif inside and (match := ITEM.match(line)):
            item = match[1]
            items[item] = match[2]
        elif inside and item:
            items[item] = f"{items[item]} {line.strip()}".strip()
    return items
