"""The gallery shows every package that it is made of, and leads only to what is there."""

from __future__ import annotations

import re
from pathlib import Path

from nerfreg.hooks import HookSpecs
from nerfreg.registry.plugins import CHECK_HOOKS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "howto" / "gallery.md").read_text(encoding="utf-8")
FIXTURES = {"binary", "broken", "namesake", "presets", "twin_a", "twin_b"}
"""The packages that show what the core does with packages."""


def test_every_package_is_shown_with_its_source() -> None:
    packages = {path.name for path in (ROOT / "tests" / "stranger" / "packages").iterdir()}
    shown = re.findall(r"literalinclude} \.\./\.\./(tests/stranger/packages/(\w+)/\S+)", PAGE)
    assert {name for _, name in shown} == packages - FIXTURES
    assert [path for path, _ in shown if not (ROOT / path).is_file()] == []


def test_every_package_is_listed_with_the_hooks_that_it_has() -> None:
    rows = re.findall(r"^\| \[[^\]]+\]\(#(\w+)\) \| ([^|]*) \|", PAGE, flags=re.M)
    for name, hooks in rows:
        [source] = (ROOT / "tests" / "stranger" / "packages" / name).glob("nerfreg_*/__init__.py")
        implemented = re.findall(r"def (nerfreg_\w+|state_dict)\(", source.read_text("utf-8"))
        assert set(re.findall(r"`(\w+)`", hooks)) == set(implemented), name
    assert [name for name, _ in rows] == re.findall(r"^## (\w+)$", PAGE, flags=re.M)


def test_every_hook_is_in_the_table_of_aims() -> None:
    hooks = {name for name in vars(HookSpecs) if name.startswith("nerfreg_")} - {*CHECK_HOOKS}
    told = {hook for hook in hooks if f"`{hook}`" in PAGE.partition("## By package")[0]}
    assert hooks - told == {"nerfreg_start", "nerfreg_end"}
