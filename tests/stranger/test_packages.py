"""The gallery: regularizers that nobody planned for, each a package of at most 60 lines."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

import nerfreg
from nerfreg.cli import main

PACKAGES = Path(__file__).parent / "packages"
STANDARD = {"torch", "__future__", "collections", "dataclasses", "math", "pathlib", "typing"}
MOST_LINES = 60
WIDTH = 100
TINY = (
    "scene.size=8", "scene.views=2", "scene.test_views=1", "field.levels=2", "field.log2_entries=8",
    "train.steps=2", "train.rays=8", "train.quiet=true", "eval.lpips=false", "eval.count=1",
)  # fmt: skip


def sources(package: str) -> list[Path]:
    return sorted((PACKAGES / package).rglob("*.py"))


def files_for(package: str, folder: Path) -> list[str]:
    """Write the files that a package reads, and return what it must be told."""
    if package != "depth_ranks":
        return []
    for view in range(8):
        iio.imwrite(folder / f"{view}_depth.png", np.arange(64, dtype=np.uint8).reshape(8, 8))
    return [f"reg.depth_ranks.maps={folder}"]


def test_is_small(package: str) -> None:
    """With docstrings, configuration and citation; only blank lines do not count."""
    lines = [line for path in sources(package) for line in path.read_text("utf-8").splitlines()]
    assert len([line for line in lines if line.strip()]) <= MOST_LINES
    assert max(map(len, lines)) <= WIDTH


def test_imports_public_names_and_torch_alone(package: str) -> None:
    for path in sources(package):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                assert {part.name.partition(".")[0] for part in node.names} <= STANDARD
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0 and node.module
                if node.module == "nerfreg":
                    assert {part.name for part in node.names} <= set(nerfreg.__all__)
                else:
                    assert node.module.partition(".")[0] in STANDARD


@pytest.mark.usefixtures("gallery")
def test_trains_by_the_command_line(
    package: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["nerfreg"])
    own = files_for(package, tmp_path)
    assert main(["train", f"+reg={package}", "hydra.run.dir=run", *TINY, *own]) == 0
    results = json.loads(Path("run/results.json").read_text("utf-8"))
    # A fresh evaluation of the run finds the plugin again, and all that the checkpoint needs.
    assert main(["evaluate", "run"]) == 0
    again = json.loads(Path("run/results.json").read_text("utf-8"))
    assert again["psnr"] == pytest.approx(results["psnr"], abs=1e-4)
    capsys.readouterr()
    assert main(["cite", "run"]) == 0
    assert capsys.readouterr().out.count("@") >= 4


@pytest.mark.parametrize(
    "case", [["--case", "run"], pytest.param([], marks=pytest.mark.slow)], ids=["run", "all"]
)
def test_pass_the_checks(
    gallery: list[str], environment: dict[str, str], tmp_path: Path, case: list[str]
) -> None:
    """In a process of its own, without the import hook for shapes, which draws random numbers."""
    own = [word for package in gallery for word in files_for(package, tmp_path)]
    command = [sys.executable, "-m", "nerfreg", "check", *gallery, *own, *case]
    shown = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert shown.returncode == 0, shown.stdout + shown.stderr
