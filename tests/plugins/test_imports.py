"""Regularizers stand alone."""

from __future__ import annotations

import ast
from pathlib import Path

import nerfreg_plugins
import pytest

ROOT = Path(nerfreg_plugins.__file__).parent
MODULES = sorted(path.relative_to(ROOT) for path in ROOT.rglob("*.py"))


def imported(path: Path) -> set[str]:
    """What a module imports of `nerfreg_plugins`, by the first name below it."""
    modules: set[str] = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            modules.add(f"{node.module}.{node.names[0].name}")
    return {name.split(".")[1] for name in modules if name.startswith("nerfreg_plugins.")}


@pytest.mark.parametrize("path", MODULES, ids=str)
def test_a_regularizer_imports_its_own_package_and_the_references(path: Path) -> None:
    own = {path.parts[0]} if len(path.parts) > 1 else set()
    allowed = set() if own == {"references"} else own | {"references"}
    assert imported(path) <= allowed


def test_every_regularizer_has_a_reference() -> None:
    names = {path.parts[0].removesuffix(".py") for path in MODULES} - {"__init__", "references"}
    assert names == {path.stem for path in (ROOT / "references").glob("[!_]*.py")}
