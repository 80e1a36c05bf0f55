"""The Python interface: what `nerfreg` exports, and every public module of a package."""

from __future__ import annotations

import pkgutil
from importlib import import_module

from nerfreg_docs.docstrings import summary
from nerfreg_docs.markdown import plain, table


def names_of_package(package: str) -> str:
    """A table of what a package exports, each name linked to where it is defined."""
    module = import_module(package)
    rows = []
    for name in module.__all__:
        thing = getattr(module, name)
        home = getattr(thing, "__module__", "")
        documented = home.startswith(package) and isinstance(thing, type)
        link = f"{{py:class}}`{name} <{home}.{name}>`" if documented else f"`{name}`"
        rows.append([link, plain(summary(thing)) if documented else ""])
    return table(["name", "meaning"], rows)


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
