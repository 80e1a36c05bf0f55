"""The documentation's own extension, which no package installs, and how commands of a page run."""

from __future__ import annotations

import importlib
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hydra.core.config_store import ConfigStore

from nerfreg.cli import main

DOCS = Path(__file__).parents[2] / "docs"

sys.path.insert(0, str(DOCS / "_ext"))

SMALL = (
    "field.levels=2", "field.log2_entries=8", "field.finest=32", "field.hidden=16",
    "sampler.coarse=8", "sampler.fine=8", "sampler.skip_resolution=16", "train.rays=256",
    "train.quiet=true", "train.threads=1", "eval.count=2",
)  # fmt: skip
SMALL_SCENE = ("scene.size=32", "scene.test_views=1")
FEW_STEPS = ("train.steps=3",)


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


@pytest.fixture
def run() -> Callable[[list[str]], None]:
    """Runs one command of a page, in this process, on smaller fields and for fewer steps.

    Fails for a command that is none of those which pages may use.
    """

    def run(words: list[str]) -> None:
        match words:
            case ["nerfreg", *rest]:
                assert main(smaller(rest)) == 0, shlex.join(words)
            case ["python", script]:
                runpy.run_path(script, run_name="__main__")
            case ["pip", "install", "."]:
                _install()
            case _:
                pytest.fail(f"a page may not use {shlex.join(words)}; see tests/docs/conftest.py")

    return run


def _install() -> None:
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
