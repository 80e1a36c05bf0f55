"""What `nerfreg new-plugin` writes works as it is: for each hook alone, and for all together."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from hydra.core.config_store import ConfigStore

from nerfreg.cli import main
from nerfreg.registry import installed
from nerfreg.registry.plugins import CHECK_HOOKS
from nerfreg.scaffold.package import CHOICES, TOGETHER

NAMES = ("every_hook", *(f"only_{hook}" for hook in CHOICES))
SIZE = (
    "scene.size=16", "scene.views=3", "scene.test_views=1", "field.levels=2",
    "field.log2_entries=8", "field.finest=32", "sampler.coarse=8", "sampler.fine=8",
    "sampler.skip_resolution=16", "train.rays=64", "train.steps=4", "train.check=true",
    "train.check_every=1", "train.quiet=true", "eval.lpips=false",
)  # fmt: skip
every_package = pytest.mark.parametrize("name", NAMES)


@pytest.fixture
def found(installed_packages: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The packages are installed until the test ends."""
    monkeypatch.syspath_prepend(installed_packages)
    yield
    ConfigStore.instance().repo.pop("reg", None)
    for module in [name for name in sys.modules if name.startswith(("nerfreg_only", "nerfreg_ev"))]:
        del sys.modules[module]


def hooks_of(name: str) -> set[str]:
    """The hooks that a package must implement."""
    if name == "every_hook":
        return set(CHOICES)
    hook = name.removeprefix("only_")
    return {hook, *TOGETHER.get(hook, ())}


@pytest.mark.usefixtures("found")
def test_each_implements_the_hooks_that_were_asked_for() -> None:
    own = {plugin.name: plugin for plugin in installed() if plugin.name in NAMES}
    assert {plugin.state for plugin in own.values()} == {"ok"}
    checked = {hook.removeprefix("nerfreg_") for hook in CHECK_HOOKS}
    for name in NAMES:
        assert set(own[name].hook_points) == hooks_of(name) - checked


@every_package
@pytest.mark.usefixtures("found", "python_random")
def test_passes_the_check_on_some_cases(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    for case in ("two_walls", "layer_0", "photos_noise"):
        assert main(["check", name, "--case", case]) == 0, capsys.readouterr().out


@pytest.mark.slow
@every_package
@pytest.mark.usefixtures("found")
def test_passes_the_whole_check(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", name]) == 0, capsys.readouterr().out


@every_package
@pytest.mark.usefixtures("found")
def test_trains(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "run"
    code = main(["train", f"+reg={name}", f"hydra.run.dir={folder}", *SIZE])
    assert code == 0, capsys.readouterr().err
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert results["psnr"] > 5
    if "metrics" in hooks_of(name):
        assert 0 <= results["metrics"][f"{name}.opacity"] <= 1


def test_their_own_tests_pass(
    written: Path, installed_packages: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    for name in NAMES:
        shutil.copy(written / name / "tests" / f"test_{name}.py", tmp_path)
    path = f"{installed_packages}:{environment['PYTHONPATH']}"
    command = [sys.executable, "-m", "pytest", "-q", "-W", "error", "-p", "no:cacheprovider"]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env={**environment, "PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    with_loss = sum("loss" in hooks_of(name) for name in NAMES)
    assert f"{len(NAMES) + 4 * with_loss} passed" in done.stdout


@every_package
def test_every_file_is_complete(written: Path, name: str) -> None:
    package = written / name
    project = tomllib.loads((package / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    module = f"nerfreg_{name}"
    assert list(project["entry-points"]["nerfreg.plugins"]) == [name]
    workflow = yaml.safe_load((package / ".github/workflows/ci.yml").read_text(encoding="utf-8"))
    commands = [step.get("run") for step in workflow["jobs"]["test"]["steps"]]
    assert f"nerfreg check {name}" in commands
    for path in (path for path in package.rglob("*.*") if path.is_file()):
        text = path.read_text(encoding="utf-8")
        assert text.endswith("\n"), path
        assert not text.endswith("\n\n"), path
        assert max(map(len, text.splitlines())) <= 100, path
        if path.name != "ci.yml":
            assert not re.search(r"{{|{%", text), path
    assert (package / module / "__init__.py").is_file()


def test_what_is_written_is_formatted(written: Path) -> None:
    ruff = shutil.which("ruff", path=str(Path(sys.executable).parent)) or shutil.which("ruff")
    if ruff is None:
        pytest.skip("ruff is not installed")
    for name in NAMES:
        lint = [ruff, "check", "--isolated", "--no-cache", "--line-length", "100"]
        formatting = [ruff, "format", "--isolated", "--no-cache", "--line-length", "100", "--diff"]
        for command in ([*lint, "--select", "E,F,W,I,B,UP"], formatting):
            done = subprocess.run(
                [*command, "."], cwd=written / name, capture_output=True, text=True
            )
            assert done.returncode == 0, done.stdout
