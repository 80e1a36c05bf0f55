"""The shape of the source tree: who imports whom, and that a name means one thing.

Imports inside functions and under TYPE_CHECKING count as imports.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import nerfreg_plugins

import nerfreg

SOURCE = Path(nerfreg.__file__).parent
PLUGINS = Path(nerfreg_plugins.__file__).parent
ORDER = (
    "errors", "numerics", "files", "scenes", "hooks", "rays", "field", "registry", "rendering",
    "training", "evaluation", "config", "runs", "analysis",
)  # fmt: skip
"""In the order in which data passes through them; each imports only those before it."""
TOOLS = ("sweeps", "checks", "prune", "reports", "bench", "scaffold")
"""These import everything in `ORDER`, and no other tool."""
AFTER_TOOLS = {"testing": {"checks"}}
"""What tests of plugins need: everything in `ORDER`, and the tools that stand here."""
ROOT_MODULES = 8


@cache
def imports(root: Path) -> dict[str, set[str]]:
    """What each module of a package imports, anywhere in it, as far as it lies in that package."""
    paths = {_name(root, path): path for path in root.rglob("*.py")}
    found: dict[str, set[str]] = {}
    for name, path in paths.items():
        targets: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                targets |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: relative import"
                modules = (f"{node.module}.{alias.name}" for alias in node.names)
                targets |= {m if m in paths else str(node.module) for m in modules}
        found[name] = targets
    return found


def _name(root: Path, path: Path) -> str:
    parts = path.relative_to(root.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def place(module: str) -> str:
    """The package or root module that a module belongs to."""
    return module.partition(".")[2].partition(".")[0]


def test_every_package_has_a_place() -> None:
    places = {place(module) for module in imports(SOURCE)} - {"", "__main__", "cli"}
    assert places == {*ORDER, *TOOLS, *AFTER_TOOLS}


def test_packages_import_only_those_before_them() -> None:
    allowed = {name: {*ORDER[:position], name} for position, name in enumerate(ORDER)}
    allowed |= {tool: {*ORDER, tool} for tool in TOOLS}
    allowed |= {name: {*ORDER, *tools, name} for name, tools in AFTER_TOOLS.items()}
    # The version alone stands in the package itself.
    wrong = [
        f"{module} imports {target}"
        for module, targets in imports(SOURCE).items()
        for target in targets
        if place(module) in allowed and target.startswith("nerfreg.")
        if place(target) not in allowed[place(module)]
    ]
    assert wrong == []


def test_modules_form_no_circle() -> None:
    for root in (SOURCE, PLUGINS):
        known = imports(root)
        graph = {module: (targets & known.keys()) - {module} for module, targets in known.items()}
        TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def test_core_imports_no_plugin_and_no_plugin_another() -> None:
    for module, targets in imports(SOURCE).items():
        assert not [name for name in targets if name.startswith("nerfreg_plugins")], module
    for module, targets in imports(PLUGINS).items():
        own = ("nerfreg_plugins.references", ".".join(module.split(".")[:2]))
        others = [name for name in targets if name.startswith("nerfreg_plugins")]
        assert not [name for name in others if not name.startswith(own)], module


def test_few_modules_lie_at_the_top() -> None:
    assert len(list(SOURCE.glob("*.py"))) <= ROOT_MODULES


def test_a_class_name_means_one_thing() -> None:
    names = Counter(
        node.name
        for root in (SOURCE, PLUGINS)
        for path in root.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    )
    assert [name for name, count in names.items() if count > 1] == []


def test_package_is_imported_without_torch(environment: dict[str, str]) -> None:
    code = (
        "import sys, nerfreg.cli; from nerfreg.cli.parser import make_parser; make_parser();"
        "sys.exit('torch' in sys.modules or 'hydra' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], env=environment).returncode == 0
