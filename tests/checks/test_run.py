from __future__ import annotations

import json
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from nerfreg import Regularizer, hookimpl
from nerfreg.checks.cases import CASES
from nerfreg.checks.layers import LAYER_CASES
from nerfreg.checks.photographs import PHOTOGRAPH_CASES
from nerfreg.cli import main
from nerfreg.registry import installed

PACKAGES = Path(__file__).parents[1] / "stranger" / "packages"


@dataclass
class Careless(Regularizer):
    """Divides by the opacity."""

    power: int = 1

    @hookimpl
    def nerfreg_loss(self, rendering):
        print("a helper of the plugin says hello")
        return {"careless": (1 / rendering.opacity**self.power).mean()}


@pytest.fixture
def careless(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plugin that fails on empty rays, and one that cannot be imported, beside ours."""
    points = [
        EntryPoint("careless", f"{__name__}:Careless", "nerfreg.plugins"),
        EntryPoint("absent", "no_such_module:Absent", "nerfreg.plugins"),
    ]
    monkeypatch.setattr(EntryPoint, "load", lambda point, load=EntryPoint.load: _load(point, load))
    monkeypatch.setattr("nerfreg.registry.plugins._entry_points", lambda: points)


def _load(point, load):
    return Careless if point.name == "careless" else load(point)


@pytest.mark.usefixtures("careless")
def test_failure_and_its_reproduction(capsys):
    assert main(["check", "--case", "empty", "careless", "--dtype", "float32", "--samples=2"]) == 1
    out = capsys.readouterr().out
    assert "careless: value: term 'careless' is inf" in out
    assert "nerfreg check careless --case empty --dtype float32 --samples 2" in out


@pytest.mark.usefixtures("careless")
def test_what_a_plugin_prints_is_no_part_of_the_report(capsys):
    words = ["check", "careless", "--case", "empty", "--dtype", "float32", "--json"]
    assert main(words) == 1
    out, err = capsys.readouterr()
    assert json.loads(out)["passed"] is False
    assert "a helper of the plugin says hello" in err


@pytest.mark.usefixtures("careless")
def test_overrides_are_typed_and_repeated_in_the_reproduction(capsys):
    words = ["check", "careless", "--case", "empty", "--dtype", "float32"]
    assert main([*words, "reg.careless.power=2"]) == 1
    assert "--samples 1 reg.careless.power=2" in capsys.readouterr().out
    assert main([*words, "reg.careless.power=two"]) == 2
    assert "reg.careless: Value 'two'" in capsys.readouterr().err
    # 1 / opacity^0 is 1
    assert main([*words, "reg.careless.power=0"]) == 0


@pytest.mark.usefixtures("careless")
def test_plugin_that_cannot_be_imported(capsys):
    assert main(["check", "--case", "fog", "--dtype", "float32", "--samples", "2"]) == 0
    output = capsys.readouterr()
    assert "nerfreg: warning: left out plugin 'absent'" in output.err
    summary = output.out.partition("\n\n")[0]
    assert [line.split()[0] for line in summary.splitlines()] == [
        "plugin",
        "compositing",
        "careless",
        "~",
    ]
    assert main(["check", "absent"]) == 2
    assert "plugin 'absent' of package nerfreg: failed to import" in capsys.readouterr().err


def test_json_is_one_document(capsys):
    assert (
        main(
            [
                "check",
                "compositing",
                "kl",
                "--case",
                "fog",
                "--dtype",
                "float64",
                "--samples",
                "2",
                "--json",
            ]
        )
        == 0
    )
    document = json.loads(capsys.readouterr().out)
    assert document["passed"] is True
    assert [plugin["name"] for plugin in document["plugins"]] == ["compositing", "kl"]
    assert document["plugins"][1]["worst"]["float64"]["case"] == "fog"
    assert document["plugins"][1]["checks"]["gradient"] == "ok"


def test_list_of_cases(capsys):
    assert main(["check", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    of_inputs = [case.name for case in (*CASES, *LAYER_CASES, *PHOTOGRAPH_CASES)]
    assert [line.split()[0] for line in lines] == [*of_inputs, "terms", "steps", "cost", "run"]
    assert max(map(len, lines)) <= 100


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["kll"], "unknown plugin 'kll'; did you mean 'kl'?"),
        (["--case", "two_wall"], "--case two_wall: did you mean 'two_walls'?"),
        (
            ["kl", "kl.density=alphas"],
            "'kl.density=alphas' is no plugin and no override; write reg.NAME.key=value",
        ),
        (["kl", "reg.kl.densit=alphas"], "unknown key 'reg.kl.densit'; did you mean 'density'?"),
        (
            ["kl", "reg.entropy.threshold=0"],
            "reg.entropy.threshold=0: plugin 'entropy' is not checked; name it too",
        ),
        (["annealing", "reg.annealing.initial=0"], "reg.annealing.initial: 0.0 is not in (0, 1]"),
    ],
)
def test_mistakes_are_named(words, message, capsys):
    assert main(["check", *words]) == 2
    assert message in capsys.readouterr().err


def test_replay(monkeypatch, tmp_path):
    replayed = []
    monkeypatch.setattr("nerfreg.runs.replay.replay", lambda path: replayed.append(path) or 1)
    assert main(["check", "--replay", str(tmp_path)]) == 1
    assert replayed == [tmp_path]


def test_strangers_plugin_passes(monkeypatch, capsys):
    monkeypatch.syspath_prepend(PACKAGES / "binary")
    point = EntryPoint("binary_opacity", "nerfreg_binary:BinaryOpacity", "nerfreg.plugins")
    monkeypatch.setattr("nerfreg.registry.plugins._entry_points", lambda: [point])
    assert main(["check", "binary_opacity", "--samples", "48", "--dtype", "float32"]) == 0
    row = capsys.readouterr().out.splitlines()[1].split()
    assert row[:2] == ["binary_opacity", "loss"]
    assert row[-1] == "ok"


STIFF = [
    ("fog", 2),
    ("empty", 48),
    ("thickness_1e30", 2),
    ("underflow", 2),
    ("sliver", 2),
    ("packed", 48),
    ("missing_depth", 2),
    ("layer_1e4", 2),
]


@pytest.mark.parametrize(("case", "samples"), STIFF)
def test_every_shipped_plugin_passes(case, samples, capsys):
    assert main(["check", "--case", case, "--samples", str(samples)]) == 0, capsys.readouterr().out


@pytest.mark.slow
def test_every_shipped_plugin_passes_the_whole_grid(capsys):
    assert main(["check"]) == 0, capsys.readouterr().out
    rows = [line.split() for line in capsys.readouterr().out.partition("\n\n")[0].splitlines()[1:]]
    assert {row[0] for row in rows} >= {"compositing", *(plugin.name for plugin in installed())}
