"""The Python interface: what `nerfreg` exports, and every public module of a package."""

from __future__ import annotations

import inspect
import pkgutil
from importlib import import_module

from nerfreg_docs.docstrings import summary
from nerfreg_docs.markdown import plain, table

OBJECTS = {
    "hookimpl": "Decorator of the methods that implement a hook: `@hookimpl`, or "
    "`@hookimpl(wrapper=True)` for a wrapper."
}
"""The meaning of objects, whose docstrings are those of their classes in other projects."""


def names_of_package(package: str) -> str:
    """A table of what a package exports, each name linked to where it is defined."""
    module = import_module(package)
    rows = []
    for name in module.__all__:
        thing = getattr(module, name)
        role = "class" if isinstance(thing, type) else "func" if inspect.isfunction(thing) else ""
        link = f"{{py:{role}}}`{name} <{thing.__module__}.{name}>`" if role else f"`{name}`"
        rows.append([link, plain(summary(thing) if role else OBJECTS.get(name, ""))])
    return table(["name", "meaning"], rows)


def names_in_full(package: str) -> str:
    """What the docstring of a package promises, and the docstring of each name that it exports."""
    module = import_module(package)
    parts = [inspect.cleandoc(module.__doc__ or "").partition("\n\n")[2], names_of_package(package)]
    for name in sorted(module.__all__, key=str.lower):
        thing = getattr(module, name)
        home = getattr(thing, "__module__", "")
        parts += [f"## `{package}.{name}`", _documented(name, thing, home)]
    return "\n\n".join(parts)


def _documented(name: str, thing: object, home: str) -> str:
    """A whole docstring; an index entry is made where the module of the name is described."""
    if isinstance(thing, type):
        options = ":members:\n   :member-order: bysource\n   :no-index:"
        return f"```{{eval-rst}}\n.. autoclass:: {home}.{name}\n   {options}\n```"
    if inspect.isfunction(thing):
        return f"```{{eval-rst}}\n.. autofunction:: {home}.{name}\n   :no-index:\n```"
    return plain(OBJECTS.get(name, ""))


def modules(package: str) -> str:
    """A section for each public module of a package, the package itself first where it has code."""
    root = import_module(package)
    names = [
        info.name
        for info in pkgutil.walk_packages(getattr(root, "__path__", []), f"{package}.")
        if not any(part.startswith("_") for part in info.name.split("."))
    ]
    return "\n\n".join(_section(name) for name in [package, *names])


def _section(name: str) -> str:
    directive = f".. automodule:: {name}\n   :members:\n   :member-order: bysource\n"
    return f"## `{name}`\n\n```{{eval-rst}}\n{directive}```"
