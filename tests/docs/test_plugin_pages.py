"""The plugins of the how-to pages train and are scored again, each as its page prints it.

Every block of Python that a page stores as `NAME.py` is a plugin of that name. The check at the end
of each run (`nerfreg.evaluation.leaks`) and a second process-like load by `nerfreg evaluate` see
whether it keeps something that no checkpoint holds.
"""

from __future__ import annotations

import importlib
import inspect
import json
import re
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from nerfreg_docs.blocks import Block, blocks, commands

from nerfreg import Regularizer
from nerfreg.hooks import ALWAYS_IN_EVALUATION, IN_EVALUATION_IF_ASKED, HookSpecs
from nerfreg.registry import plugins

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(path.stem for path in (DOCS / "howto").glob("plugin_*.md"))
SPECS = {name: spec for name, spec in vars(HookSpecs).items() if name.startswith("nerfreg_")}


def plugins_of(page: str) -> list[Block]:
    """The blocks of a page that are plugins."""
    text = (DOCS / "howto" / f"{page}.md").read_text(encoding="utf-8")
    return [block for block in blocks(text) if block.file]


ALL = [(page, block.file) for page in PAGES for block in plugins_of(page)]


@pytest.fixture
def installed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which every plugin of the pages is found, until the test ends."""
    points = plugins._entry_points()
    for page in PAGES:
        for block in plugins_of(page):
            path = folder / str(block.file)
            path.write_text(block.text, encoding="utf-8")
            [cls] = re.findall(r"^class (\w+)\(Regularizer\)", block.text, flags=re.M)
            points.append(EntryPoint(path.stem, f"{path.stem}:{cls}", plugins.GROUP))
    monkeypatch.setattr(plugins, "_entry_points", lambda: points)
    monkeypatch.syspath_prepend(folder)
    importlib.invalidate_caches()
    return folder


@pytest.mark.parametrize(("page", "file"), ALL)
def test_plugin_trains_and_is_scored_again(page: str, file: str, installed: Path, run) -> None:
    name = file.removesuffix(".py")
    folder = installed / "run"
    words = [f"+reg={name}", "hydra.run.dir=run", "train.check=true", "eval.lpips=false"]
    run(["nerfreg", "train", *words])
    trained = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    run(["nerfreg", "evaluate", "run"])
    again = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert trained["skipped_steps"] == 0
    assert again["psnr"] == pytest.approx(trained["psnr"], abs=1e-6)
    assert again.get("metrics") == trained.get("metrics")


@pytest.mark.parametrize("page", PAGES)
def test_commands_run(page: str, installed: Path, run) -> None:
    for block in blocks((DOCS / "howto" / f"{page}.md").read_text(encoding="utf-8")):
        if block.language == "console":
            for words in commands(block.text):
                run(words)


def test_files_have_names_of_their_own() -> None:
    names = [file for _, file in ALL]
    assert len(set(names)) == len(names) > 20


def test_every_block_of_python_is_a_plugin_that_is_tested() -> None:
    for page in PAGES:
        text = (DOCS / "howto" / f"{page}.md").read_text(encoding="utf-8")
        assert text.count("```python") == len(plugins_of(page)), page


def test_every_hook_is_shown() -> None:
    shown = {
        hook
        for page in PAGES
        for block in plugins_of(page)
        for hook in re.findall(r"def (nerfreg_\w+)", block.text)
    }
    # The others are in the tutorial.
    assert SPECS.keys() - shown == {"nerfreg_ray_bounds", "nerfreg_reference", "nerfreg_contract"}


def test_table_of_hooks_is_that_of_the_specifications() -> None:
    page = (DOCS / "tutorials" / "your_regularizer.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(nerfreg_\w+)\(([^)]*)\)` \|.*\| ([^|]*) \|$", page, flags=re.M)
    expected = []
    for name, spec in SPECS.items():
        arguments = ", ".join(list(inspect.signature(spec).parameters)[1:])
        called = (
            "always"
            if name in ALWAYS_IN_EVALUATION
            else "if asked"
            if name in IN_EVALUATION_IF_ASKED
            else "views"
            if name == "nerfreg_metrics"
            else "no"
        )
        expected.append((name, arguments, called))
    assert rows == expected


def test_fields_of_the_base_class_are_explained() -> None:
    page = (DOCS / "howto" / "plugin_configuration.md").read_text(encoding="utf-8")
    variables = {
        name
        for name in inspect.get_annotations(Regularizer)
        if "ClassVar" in str(inspect.get_annotations(Regularizer)[name])
    } - {"schedules"}
    assert {name for name in variables if f"`{name}`" not in page and name not in page} == set()
