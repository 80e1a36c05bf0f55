"""The verb from the command line's point of view."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from nerfreg.cli import main
from nerfreg.config.schema import Config
from nerfreg.prune import trials
from nerfreg.prune.ledger import Measurement
from nerfreg.prune.plan import Trial
from nerfreg.prune.run import fingerprint

TINY = [
    "scene.size=16", "scene.views=2", "scene.test_views=1", "field.levels=2",
    "field.log2_entries=8", "train.rays=32", "sampler.coarse=8", "sampler.fine=8",
    "train.steps=4", "train.threads=1", "sampler.skip_resolution=8",
]  # fmt: skip


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "nothing is selected that could be left out; add +reg="),
        (["+reg=vanilla"], "nothing is selected that could be left out"),
        (["+reg=kl", "reg.kl.weight=0"], "nothing is selected that could be left out"),
        (["+reg=kll"], "unknown plugin or preset 'kll'"),
        (["+reg=kl", "scene.held_out=[1]"], "scene.held_out=[1]: prune chooses itself"),
        (["+reg=kl", "scene.views=1"], "the scene has 1 training view"),
        (
            ["+reg=kl", "scene.views=3", "--folds", "4"],
            "--folds 4: 3 training views make 2 to 3 folds",
        ),
        (["+reg=kl", "train.steps=5", "--steps", "6"], "--steps 6: more than train.steps=5"),
        (["+reg=kl", "train.steps=null", "train.seconds=5"], "train.steps=null: set it"),
        (["+reg=kl", "--name", "kl"], "--name kl: a plugin or preset of this name exists"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    words: list[str], message: str, elsewhere: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["prune", *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith("nerfreg: error: ") and message in error and error.count("\n") == 1
    assert not list(elsewhere.iterdir())


def test_fingerprint(compose: Callable[..., Config]) -> None:
    base = ("+reg=kl", "train.quiet=true")
    own = fingerprint(compose(*base), 2)
    for same in (("seed=3",), ("name=x",), ("train.quiet=false",), ("scene.held_out=[0]",)):
        assert fingerprint(compose(*base, *same), 2) == own
    for other in (
        ("reg.kl.weight=0.1",),
        ("train.rays=8",),
        ("scene.views=3",),
        ("train.threads=1",),
    ):
        assert fingerprint(compose(*base, *other), 2) != own
    assert fingerprint(compose(*base), 1) != own


def test_a_whole_study(
    elsewhere: Path, capsys: pytest.CaptureFixture[str], compose: Callable[..., Config]
) -> None:
    # so much tolerance that the first look decides, and nothing is trained after it
    words = [
        "prune",
        "+reg=[distortion]",
        "reg.distortion.weight=0.125",
        *TINY,
        "--steps",
        "4",
        "--tolerance",
        "5",
    ]
    assert main([*words, "-o", "out"]) == 0
    shown = capsys.readouterr().out
    assert "What each regularizer adds: procedural-orbit, 2 training views" in shown
    assert "Sets, against the full one" in shown
    record = json.loads((elsewhere / "out" / "prune.json").read_text())
    assert record["command"][2:] == [*words[1:], "-o", "out"]
    assert record["design"]["folds"] == [[0], [1]] and record["design"]["ladder"] == [4]
    assert [(c["regularizer"], c["context"], c["verdict"]) for c in record["contributions"]] == [
        ("distortion", "set", "no difference"),
        ("distortion", "alone", "no difference"),
    ]
    assert (record["pruned"], record["dropped"]) == ([], ["distortion"])
    # every number can be traced: a mean gain is that of the trials
    scores = {
        (tuple(t["regularizers"]), *t["held_out"], t["seed"], t["steps"]): t["psnr"]
        for t in record["trials"]
    }
    one = record["contributions"][0]
    sets = (tuple(one["having"]), tuple(one["lacking"]))
    gains = [
        scores[sets[0], *cell] - scores[sets[1], *cell]
        for cell in {key[1:] for key in scores if key[-1] == one["steps"]}
        if (sets[0], *cell) in scores and (sets[1], *cell) in scores
    ]
    assert one["gain"]["mean"] == pytest.approx(sum(gains) / len(gains)) and one["gain"][
        "count"
    ] == len(gains)
    # and what is left composes
    preset = elsewhere / "conf" / "reg" / "pruned_procedural_orbit.yaml"
    assert record["preset"] == str(preset.relative_to(elsewhere))
    assert "nerfreg prune '+reg=[distortion]'" in preset.read_text()
    assert compose("+reg=pruned_procedural_orbit").reg == {}


def test_a_stop_costs_one_training(
    elsewhere: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[Trial] = []

    def measure(self: trials.Trials, trial: Trial) -> Measurement:
        asked.append(trial)
        if len(asked) == 11:
            raise KeyboardInterrupt
        gain = {"distortion": 1.0, "lipschitz": -1.0}
        level = trial.seed + trial.held_out[0]
        noise = 0.01 * (hash((trial.held_out, trial.seed)) % 7) * len(trial.regularizers)
        return Measurement(
            20.0 + level + sum(gain[n] for n in trial.regularizers) + noise,
            None,
            0.1,
            0.1 * trial.steps,
        )

    monkeypatch.setattr(trials.Trials, "__call__", measure)
    words = ["prune", "+reg=[distortion,lipschitz]", *TINY, "train.quiet=true", "--name", "mine"]
    assert main(words) == 130
    shown = capsys.readouterr()
    assert "cells.jsonl keeps what is measured" in shown.err
    assert (
        len((elsewhere / "prune" / "procedural_orbit" / "cells.jsonl").read_text().splitlines())
        == 10
    )
    assert main(words) == 0
    assert "10 of" in capsys.readouterr().out
    # all but the one that was stopped were asked for once
    assert sorted(map(repr, asked)) == sorted([*map(repr, set(asked)), repr(asked[10])])
    record = json.loads((elsewhere / "prune" / "procedural_orbit" / "prune.json").read_text())
    assert (record["pruned"], record["dropped"]) == (["distortion"], ["lipschitz"])
    assert (
        "defaults: [distortion, _self_]" in (elsewhere / "conf" / "reg" / "mine.yaml").read_text()
    )
    # again, and nothing is left to train
    count = len(asked)
    assert main(words) == 0 and len(asked) == count
