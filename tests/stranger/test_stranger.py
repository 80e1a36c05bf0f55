"""A stranger's plugin can do all that ours can: these packages are not known to the core."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch

from nerfreg.cli import main
from nerfreg.registry import Hooks, installed

PACKAGES = Path(__file__).parent / "packages"


@pytest.fixture
def good(good_packages: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(good_packages)


@pytest.fixture
def bad(bad_packages: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(bad_packages)


def test_is_what_the_documentation_prints() -> None:
    source = (PACKAGES / "binary" / "nerfreg_binary" / "__init__.py").read_text(encoding="utf-8")
    page = (PACKAGES.parents[2] / "docs" / "tutorials" / "your_regularizer.md").read_text(
        encoding="utf-8"
    )
    assert f"```python\n{source}```" in page


@pytest.mark.usefixtures("good")
def test_is_listed_like_ours(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plugins"]) == 0
    rows = [line.split("\t") for line in capsys.readouterr().out.splitlines()]
    opacity = "Opacity is 0 or 1 (Lombardi et al. 2019)."
    assert ["binary_opacity", "nerfreg-binary", "1.2", "loss", opacity, "ok"] in rows


@pytest.mark.usefixtures("good")
def test_composes_with_its_fields_typed(compose) -> None:
    plugin = compose("+reg=binary_opacity", "reg.binary_opacity.weight=1e-2").reg["binary_opacity"]
    assert type(plugin).__name__ == "BinaryOpacity"
    assert (plugin.weight, plugin.sharpness) == (0.01, 1.0)


@pytest.mark.usefixtures("good")
def test_loss_reaches_the_core(compose, rendering, step) -> None:
    hooks = Hooks(compose("+reg=binary_opacity", "reg.binary_opacity.sharpness=2").reg)
    [term] = hooks.losses(rendering(opacity=torch.tensor([0.0, 0.5, 1.0, 0.5])), step(index=0))
    assert (term.plugin, term.name, term.weight) == ("binary_opacity", "binary_opacity", 1e-3)
    # o (1 - o) is 0, 1/4, 0, 1/4; squared and averaged: (2 / 16) / 4
    assert term.value.item() == pytest.approx(1 / 32)


@pytest.mark.usefixtures("good")
def test_unknown_key_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(["train", "--cfg", "job", "+reg=binary_opacity", "reg.binary_opacity.sharpnes=2"]) == 2
    )
    expected = (
        "unknown key 'reg.binary_opacity.sharpnes'; did you mean 'reg.binary_opacity.sharpness'?"
    )
    assert expected in capsys.readouterr().err


@pytest.mark.usefixtures("good")
def test_preset_of_a_package(compose) -> None:
    reg = compose("+reg=gloom").reg
    assert {name: plugin.weight for name, plugin in reg.items()} == {
        "dim": 0.5,
        "full_geometry": 0.125,
    }


@pytest.mark.usefixtures("good")
def test_defaults_follow_the_layout_unless_overridden(compose) -> None:
    assert compose("+reg=dim", "scene.layout=forward").reg["dim"].weight == 0.25
    assert compose("+reg=gloom", "scene.layout=forward").reg["dim"].weight == 0.25
    assert compose("+reg=dim", "scene.layout=forward", "reg.dim.weight=2").reg["dim"].weight == 2.0


@pytest.mark.usefixtures("bad")
def test_broken_package_is_reported_and_skipped(
    compose, capsys: pytest.CaptureFixture[str]
) -> None:
    states = {plugin.name: plugin.state for plugin in installed()}
    assert states["broken"] == (
        "failed to import: ModuleNotFoundError: No module named 'a_module_that_nobody_has'"
    )
    assert states["kl"] == "ok"
    assert main(["train", "--cfg", "job", "+reg=kl"]) == 0
    assert (
        "warning: plugin 'broken' of package nerfreg-broken is left out" in capsys.readouterr().err
    )


@pytest.mark.usefixtures("bad")
def test_broken_package_is_an_error_when_selected(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--cfg", "job", "+reg=broken"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith(
        "nerfreg: error: plugin 'broken' of package nerfreg-broken: failed to import"
    )


@pytest.mark.usefixtures("bad")
def test_two_packages_with_one_name_are_both_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--cfg", "job", "+reg=twin"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert "claimed by both nerfreg-twin-a and nerfreg-twin-b" in error
    assert [plugin.package for plugin in installed() if plugin.name == "twin"] == [
        "nerfreg-twin-a",
        "nerfreg-twin-b",
    ]


def test_trains_in_a_process_of_its_own(
    good: None, environment: dict[str, str], tmp_path: Path
) -> None:
    """No import hook for shapes: what a user of that package would do."""
    size = [
        "scene.size=8",
        "scene.views=2",
        "scene.test_views=1",
        "field.levels=2",
        "field.log2_entries=8",
    ]
    budget = [
        "train.steps=2",
        "train.rays=8",
        "train.quiet=true",
        "eval.lpips=false",
        "eval.count=1",
    ]
    command = [
        sys.executable,
        "-m",
        "nerfreg",
        "train",
        "+reg=[binary_opacity,kl]",
        "hydra.run.dir=run",
        *size,
        *budget,
    ]
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, timeout=300)
    record = (tmp_path / "run" / "metrics.jsonl").read_text(encoding="utf-8").splitlines()[-1]
    assert '"binary_opacity"' in record
