"""Every `console` and `python` block of the tutorials runs, in order, in one folder a page.

A block is stored in a file if the text before it ends in the name of one, such as "`name.py`:".
Commands run in this process, on smaller fields, fewer rays and fewer steps than the page asks for.
"""

from __future__ import annotations

import importlib
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from hydra.core.config_store import ConfigStore

from nerfreg.cli import main

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("quick_start", *(f"tutorials/{path.stem}" for path in (DOCS / "tutorials").glob("*.md")))
BLOCK = re.compile(r"(?P<before>[^\n]*)\n\n```(?P<language>\w+)\n(?P<text>.*?)^```$", re.M | re.S)
FILE = re.compile(r"`(?P<name>[\w./-]+\.\w+)`[^`]*:$")

SMALL = (
    "field.levels=2", "field.log2_entries=8", "field.finest=32", "field.hidden=16",
    "sampler.coarse=8", "sampler.fine=8", "sampler.skip_resolution=16", "train.rays=256",
    "train.quiet=true", "train.threads=1", "eval.count=2",
)  # fmt: skip
SMALL_SCENE = ("scene.size=32", "scene.test_views=1")
FEW_STEPS = ("train.steps=3",)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page. `file` is where it is stored; None runs it."""

    language: str
    text: str
    file: str | None


def blocks(page: str) -> list[Block]:
    """The fenced blocks of a page's source, in order."""
    found = []
    for match in BLOCK.finditer(page):
        named = FILE.search(match["before"])
        found.append(Block(match["language"], match["text"], named["name"] if named else None))
    return found


def commands(text: str) -> Iterator[list[str]]:
    """The words of each command that follows a prompt; comments are left out."""
    for line in text.replace("\\\n", " ").splitlines():
        if line.startswith("$ "):
            yield shlex.split(line.removeprefix("$ "), comments=True)


def smaller(words: list[str]) -> list[str]:
    """A command of `nerfreg` whose run takes a second; later overrides win."""
    if words[0] == "render":
        return ["frames=2" if word.startswith("frames=") else word for word in words]
    if words[0] != "train":
        return words
    scene = () if any(word.startswith("scene=") for word in words) else SMALL_SCENE
    return [*words, *SMALL, *scene, *FEW_STEPS]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The working directory of a page, in which installed plugins are found until the test ends."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path / "installed")
    yield tmp_path
    ConfigStore.instance().repo.pop("reg", None)
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", None)).startswith(str(tmp_path)):
            del sys.modules[name]


def install() -> None:
    """`pip install .` into a folder of the page, from what is installed here already."""
    # With --target pip keeps the metadata of an older version.
    shutil.rmtree("installed", ignore_errors=True)
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet"]
    target = ["--disable-pip-version-check", "--target", "installed", "."]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, *target], check=True)
    importlib.invalidate_caches()
    # Another test may have imported an older package of the same name.
    packages = {path.name for path in Path("installed").iterdir()}
    for module in [name for name in sys.modules if name.partition(".")[0] in packages]:
        del sys.modules[module]


def run(words: list[str]) -> None:
    """One command of a page. Fails for one that is none of those which pages may use."""
    match words:
        case ["nerfreg", *rest]:
            assert main(smaller(rest)) == 0, shlex.join(words)
        case ["python", script]:
            runpy.run_path(script, run_name="__main__")
        case ["pip", "install", "."]:
            install()
        case _:
            pytest.fail(f"a page may not use {shlex.join(words)}; see this test")


@pytest.mark.parametrize("page", PAGES)
def test_page_runs(page: str, folder: Path) -> None:
    for block in blocks((DOCS / f"{page}.md").read_text(encoding="utf-8")):
        if block.file:
            path = folder / block.file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, encoding="utf-8")
        elif block.language == "console":
            for words in commands(block.text):
                run(words)
        elif block.language == "python":
            exec(compile(block.text, page, "exec"), {"__name__": "__main__"})


def test_blocks_are_found_with_their_files() -> None:
    page = (
        "Save `a/b.py`:\n\n```python\nx = 1\n```\n\nRun `it`:\n\n```console\n$ nerfreg train\n```\n"
    )
    assert blocks(page) == [
        Block("python", "x = 1\n", "a/b.py"),
        Block("console", "$ nerfreg train\n", None),
    ]


def test_commands_are_told_from_output() -> None:
    text = "$ nerfreg train \\\n  '+reg=[kl]'  # a comment\npsnr 27.3\n$ nerfreg plugins\n"
    assert list(commands(text)) == [["nerfreg", "train", "+reg=[kl]"], ["nerfreg", "plugins"]]
