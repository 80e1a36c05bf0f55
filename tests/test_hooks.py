"""The shape of the source tree: who may import whom, and what a window and a union mean."""

from __future__ import annotations

import ast
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

import nerfreg
from nerfreg.hooks import Needs, Regularizer

SOURCE = Path(nerfreg.__file__).parent
ROOMS = (
    "scenes",
    "rays",
    "field",
    "rendering",
    "training",
    "evaluation",
    "reports",
    "checks",
    "bench",
    "prune",
)
"""In the order in which data passes through them."""


def imported(path: Path) -> set[str]:
    """Modules that a file imports, anywhere in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def test_core_imports_no_plugin() -> None:
    for path in SOURCE.rglob("*.py"):
        assert not [name for name in imported(path) if name.startswith("nerfreg_plugins")], path


def test_rooms_import_only_rooms_before_them() -> None:
    for position, room in enumerate(ROOMS):
        later = tuple(f"nerfreg.{name}" for name in ROOMS[position + 1 :])
        for path in (SOURCE / room).rglob("*.py"):
            assert not [name for name in imported(path) if name.startswith(later)], path


def test_rooms_do_not_know_the_command_line() -> None:
    # the benches and the study compose configurations themselves, as runs do
    for room in ROOMS[: ROOMS.index("bench")]:
        for path in (SOURCE / room).rglob("*.py"):
            assert not imported(path) & {
                "nerfreg.cli",
                "nerfreg.cli.launch",
                "nerfreg.config",
                "nerfreg.runs",
            }, path


def test_package_is_imported_without_torch(environment: dict[str, str]) -> None:
    code = "import sys, nerfreg, nerfreg.cli; sys.exit('torch' in sys.modules or 'hydra' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], env=environment).returncode == 0


def test_names_for_plugins_are_found_lazily() -> None:
    from nerfreg import hooks

    for name in ("Regularizer", "hookimpl", "Needs", "Rays", "Samples", "Rendering", "Step"):
        assert getattr(nerfreg, name) is getattr(hooks, name)
    assert {*nerfreg.__all__} <= {*dir(nerfreg)}
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = nerfreg.nothing


@pytest.mark.parametrize(
    ("start", "end", "active"),
    [
        (0.0, 1.0, [0, 1, 50, 99, 100]),
        (0, 1.0, [0, 1, 50, 99, 100]),
        (1, 50, [1]),  # [start, end): step 50 is out
        (0.5, 1.0, [50, 99, 100]),
        (0.0, 0.5, [0, 1]),
        (99, 100, [99]),
        (0.99, 100, [99]),  # one a fraction, the other a step
    ],
)
def test_window(step, start, end, active) -> None:
    plugin = Regularizer(start=start, end=end)
    assert [index for index in (0, 1, 50, 99, 100) if plugin.active(step(index=index))] == active


def test_needs_unite() -> None:
    patches = Needs(patch_size=4, patch_fraction=0.25, neighbors="patch")
    others = Needs(
        patch_size=2, patch_fraction=0.5, neighbors="extra", unseen_rays=0.1, unseen_patches=0.2
    )
    assert patches | others == others | patches == Needs(4, 0.5, "extra", 0.1, 0.2)
    assert Needs() | Needs() == Needs()


def test_a_subclass_keeps_the_base_fields_first() -> None:
    @dataclass
    class Plugin(Regularizer):
        extra: int = 3

    assert Plugin(0.5) == Plugin(weight=0.5, start=0.0, end=1.0, extra=3)
