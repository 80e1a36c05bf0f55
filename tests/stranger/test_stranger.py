"""A stranger's plugin can do all that ours can: these packages are not known to the core."""

from __future__ import annotations

import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
import torch

from nerfreg import NerfregError
from nerfreg.cli import main
from nerfreg.config.compose import compose as compose_in_program
from nerfreg.registry import Hooks, installed

PACKAGES = Path(__file__).parent / "packages"
SIZE = (
    "scene.size=8", "scene.views=2", "scene.test_views=1", "field.levels=2", "field.log2_entries=8",
)  # fmt: skip
BUDGET = ("train.steps=2", "train.rays=8", "train.quiet=true", "eval.lpips=false", "eval.count=1")


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
def test_two_packages_with_one_name_are_both_named(
    compose, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", "--cfg", "job", "+reg=twin"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    claim = "plugin 'twin' is claimed by both nerfreg-twin-a and nerfreg-twin-b"
    assert claim in error and "write +reg=nerfreg-twin-a:twin or +reg=nerfreg-twin-b:twin" in error
    reg = compose("+reg=[nerfreg-twin-a:twin,nerfreg-twin-b:twin@second]").reg
    modules = {name: type(plugin).__module__ for name, plugin in reg.items()}
    assert modules == {"twin": "nerfreg_twin_a", "second": "nerfreg_twin_b"}


@pytest.mark.usefixtures("bad")
def test_both_are_listed_by_what_selects_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plugins"]) == 0
    rows = [line.split("\t") for line in capsys.readouterr().out.splitlines()]
    states = {row[0]: row[-1] for row in rows if row[0].endswith("twin")}
    assert states == {
        "nerfreg-twin-a:twin": "the name 'twin' is also that of nerfreg-twin-b; "
        "select it by +reg=nerfreg-twin-a:twin",
        "nerfreg-twin-b:twin": "the name 'twin' is also that of nerfreg-twin-a; "
        "select it by +reg=nerfreg-twin-b:twin",
    }


@pytest.fixture
def namesake(namesake_package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(namesake_package)


@pytest.mark.usefixtures("namesake")
def test_a_built_in_stays_usable_beside_a_namesake(
    compose, capsys: pytest.CaptureFixture[str]
) -> None:
    assert type(compose("+reg=kl").reg["kl"]).__name__ == "KLDivergence"
    assert type(compose("+reg=combinerf").reg["kl"]).__name__ == "KLDivergence"
    assert main(["train", "--cfg", "job", "+reg=kl"]) == 0
    assert capsys.readouterr().err == (
        "nerfreg: warning: package nerfreg-namesake: the name 'kl' is that of a built-in; "
        "select this one by +reg=nerfreg-namesake:kl\n"
    )


@pytest.mark.usefixtures("namesake")
def test_a_namesake_is_addressed_by_its_package(compose) -> None:
    plugin = compose("+reg=nerfreg-namesake:kl", "reg.kl.power=3").reg["kl"]
    assert (type(plugin).__name__, plugin.power, plugin.weight) == ("Other", 3.0, 0.5)
    both = compose(
        "+reg=[kl,nerfreg_namesake:kl@theirs]", "scene.layout=forward", "reg.theirs.power=3"
    ).reg
    assert {name: plugin.weight for name, plugin in both.items()} == {"kl": 1e-5, "theirs": 0.25}
    assert both["theirs"].power == 3.0 and both["theirs"].reduction == "mean"


@pytest.mark.usefixtures("namesake")
@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["+reg=[kl,nerfreg-namesake:kl]"],
            "two plugins would be called 'kl'; give one of them another name, as in "
            "+reg=plugin@name",
        ),
        (
            ["+reg=nerfreg-namesake:kll"],
            "package nerfreg-namesake has no plugin 'kll'; did you mean 'kl'?",
        ),
        (["+reg=nerfreg-namesake:kl", "reg.kl.power=0.5"], "reg.kl: ValueError: power is below 1"),
        (
            ["+reg=nerfreg-namesake:kl@x", "reg.x.power={schedule:linear,from:1,to:0.5}"],
            "reg.x: ValueError: power is below 1",
        ),
        (
            ["+reg=nerfreg-namesake:kl", "reg.kl.reduction=man"],
            "reg.kl.reduction: 'man' is no choice; did you mean 'mean'?",
        ),
    ],
)
def test_what_a_namesake_refuses(overrides: list[str], message: str) -> None:
    with pytest.raises(NerfregError) as caught:
        compose_in_program(overrides)
    assert message in str(caught.value)


@pytest.mark.usefixtures("namesake")
def test_a_run_with_two_of_a_name_is_scored_again(
    environment: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["+reg=[kl,nerfreg-namesake:kl@theirs]", "hydra.run.dir=run"]
    schedule = "reg.theirs.power={schedule:exponential,from:1,to:4,end:0.5}"
    command = [sys.executable, "-m", "nerfreg", "train", *words, schedule, *SIZE, *BUDGET]
    run = partial(subprocess.run, cwd=tmp_path, env=environment, check=True, timeout=300)
    trained = run(command, capture_output=True, text=True).stdout
    assert "note of theirs: Scores are those of a namesake.\n" in trained
    run([sys.executable, "-m", "nerfreg", "evaluate", "run"])
    results = json.loads((tmp_path / "run" / "results.json").read_text(encoding="utf-8"))
    assert results["plugins"]["theirs"] == {
        "plugin": "nerfreg-namesake:kl",
        "package": "nerfreg-namesake",
        "version": "3.1",
    }
    assert results["plugins"]["kl"]["package"] == "nerfreg"
    assert results["notes"] == {"theirs": "Scores are those of a namesake."}
    written = {"schedule": "exponential", "from": 1.0, "to": 4.0, "end": 0.5}
    assert results["regularizers"]["theirs"]["power"] == written
    assert main(["cite", str(tmp_path / "run")]) == 0
    bibliography = capsys.readouterr().out
    assert "{stranger2021other," in bibliography and "{kim2022infonerf," in bibliography


def test_trains_in_a_process_of_its_own(
    good: None, environment: dict[str, str], tmp_path: Path
) -> None:
    """No import hook for shapes: what a user of that package would do."""
    command = [
        sys.executable,
        "-m",
        "nerfreg",
        "train",
        "+reg=[binary_opacity,kl]",
        "hydra.run.dir=run",
        *SIZE,
        *BUDGET,
    ]
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, timeout=300)
    record = (tmp_path / "run" / "metrics.jsonl").read_text(encoding="utf-8").splitlines()[-1]
    assert '"binary_opacity"' in record
