"""The files of a new package, from the templates beside this module."""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import date
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

import nerfreg
from nerfreg.errors import NerfregError, nearest
from nerfreg.registry.plugins import HOOKS
from nerfreg.scaffold.names import PluginNames

TEMPLATES = Path(__file__).parent / "templates"
CHOICES = tuple(hook.removeprefix("nerfreg_") for hook in HOOKS)
"""The hooks that a package can be made with, in the order in which a run calls them."""

TOGETHER = {
    "module": ("color_input",),
    "color_input": ("module",),
    "prepare": ("loss",),
    "unseen_poses": ("needs",),
    "reference": ("loss",),
    "contract": ("loss",),
}
"""What one hook is useless without, or has no meaning without."""

WIDTH = 100
"""Of a line; what does not fit is imported one name a line, as formatters write it."""

STANDARD = {"ClassVar": "typing", "dataclass": "dataclasses", "replace": "dataclasses"}
"""The modules of the standard library that names in the templates come from."""

FOREIGN = {
    "mpmath": "",
    "torch": "",
    "exact": "nerfreg.numerics",
    "nn": "torch",
    **dict.fromkeys(nerfreg.__all__, "nerfreg"),
}
"""The modules that other names come from; none for a name that is a module itself."""


def chosen_hooks(words: Iterable[str]) -> tuple[str, ...]:
    """Return hooks, and those that belong to them, in the order of a run.

    Args:
        words: Names of hooks, with or without `nerfreg_`; `all` stands for all of them.

    Raises:
        NerfregError: There is no such hook, or none is named.
    """
    wanted: set[str] = set()
    for word in (word.removeprefix("nerfreg_") for word in words):
        if word not in (*CHOICES, "all"):
            raise NerfregError(f"--hook {word}: {nearest(word, (*CHOICES, 'all'))}")
        wanted |= set(CHOICES) if word == "all" else {word, *TOGETHER.get(word, ())}
    if not wanted:
        raise NerfregError("--hook needs a value: --hook NAME,NAME, or --hook all")
    return tuple(hook for hook in CHOICES if hook in wanted)


def package_files(names: PluginNames, hooks: Sequence[str]) -> dict[Path, str]:
    """Return the text of each file of a package by its path in the package's folder.

    Args:
        names: What it is called.
        hooks: The hooks that its plugin implements, in the order of a run.
    """
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    values = {
        "name": names.plugin,
        "distribution": names.distribution,
        "module": names.module,
        "cls": names.cls,
        "hooks": hooks,
        "version": nerfreg.__version__,
        "year": date.today().year,
    }
    parts = [environment.get_template(f"hooks/{hook}.py.j2").make_module(values) for hook in hooks]

    def text(template: str) -> str:
        return environment.get_template(template).render(values, parts=parts).lstrip("\n")

    body = _spaced(text("plugin.py.j2"))
    return {
        Path("pyproject.toml"): text("pyproject.toml.j2"),
        Path("README.md"): text("README.md.j2"),
        Path(names.module, "__init__.py"): f"{_imports(names, body)}\n\n\n{body}",
        Path("tests", f"test_{names.plugin}.py"): text("test.py.j2"),
        Path(".github", "workflows", "ci.yml"): text("ci.yml.j2"),
    }


def _imports(names: PluginNames, body: str) -> str:
    """Return the docstring of the module, and the imports of what its body uses."""
    used = {node.id for node in ast.walk(ast.parse(body)) if isinstance(node, ast.Name)}
    docstring = f'"""{names.plugin}, a regularizer for nerfreg."""'
    return "\n\n".join([docstring, *filter(None, (_lines(STANDARD, used), _lines(FOREIGN, used)))])


def _lines(origins: Mapping[str, str], used: Collection[str]) -> str:
    """Return the import lines of those names that are used, one for each module."""
    modules = {origins[name] for name in used if name in origins}
    lines = [f"import {name}" for name in sorted(used) if origins.get(name) == ""]
    for module in sorted(filter(None, modules)):
        taken = sorted(name for name in used if origins.get(name) == module)
        line = f"from {module} import {', '.join(taken)}"
        if len(line) > WIDTH:
            line = "\n".join([f"from {module} import (", *(f"    {name}," for name in taken), ")"])
        lines.append(line)
    return "\n".join(lines)


def _spaced(text: str) -> str:
    """Leave two empty lines at most between definitions, and one inside of them."""
    text = re.sub(r"\n{4,}", "\n\n\n", text)
    return re.sub(r"\n{3,}(?= )", "\n\n", text).strip("\n") + "\n"
