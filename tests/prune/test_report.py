from __future__ import annotations

import io
import json
import math
import random

import pytest
from rich.console import Console

from nerfreg.analysis.statistics import Interval
from nerfreg.files import json_text
from nerfreg.prune.ledger import Difference, Ledger, Measurement
from nerfreg.prune.plan import Design, Trial, make_folds, make_ladder
from nerfreg.prune.report import (
    conclusions,
    duration,
    ends,
    finding_sentence,
    print_report,
    ranked_sets,
    record,
)
from nerfreg.prune.study import Study

GAINS = {"kl": 1.0, "lipschitz": -1.0}


def measure(trial: Trial) -> Measurement:
    """Let kl help by 1 dB, lipschitz hurt as much and double the time of a step."""
    noise = random.Random(repr(trial)).gauss(0, 0.01)
    level = 20.0 + trial.seed + sum(GAINS[name] for name in trial.regularizers)
    step_seconds = 0.02 if "lipschitz" in trial.regularizers else 0.01
    return Measurement(
        level + noise,
        0.1 - 0.01 * len(trial.regularizers),
        step_seconds,
        step_seconds * trial.steps,
    )


def studied(budget: float) -> Study:
    design = Design(("kl", "lipschitz"), make_folds(4, None), make_ladder(None, 100))
    study = Study(design, Ledger(measure), budget, 0.1, lambda line: None)
    study.run()
    return study


def test_sets_and_their_front() -> None:
    found = ranked_sets(studied(1000.0))
    points = {point.regularizers: point for point in found if point.found.steps == 25}
    expected = {
        ("kl",): (1.0, -0.5, True),
        (): (0.0, -0.5, False),
        ("kl", "lipschitz"): (0.0, 0.0, False),
    }
    for names, (gain, time, on_front) in expected.items():
        assert points[names].found.gain.mean == pytest.approx(gain, abs=0.05)
        assert points[names].found.time.mean == pytest.approx(time)
        assert points[names].on_front is on_front
    assert points[("lipschitz",)].found.gain.mean == pytest.approx(-1.0, abs=0.05)
    # `average` falls by 0.01 with each regularizer, and this set has one fewer than the full one.
    assert points[("kl",)].found.average == pytest.approx(0.01)
    # The longest stand first: what was confirmed, by whole runs. Their front is another one.
    assert [(point.regularizers, point.found.steps, point.on_front) for point in found[:2]] == [
        (("kl",), 100, True),
        (("kl", "lipschitz"), 100, False),
    ]
    assert [point.found.steps for point in found] == [100, 100, 25, 25, 25, 25]
    assert [point.found.gain.mean for point in found[2:]] == sorted(
        (point.found.gain.mean for point in found[2:]), reverse=True
    )


def test_what_is_printed() -> None:
    out = io.StringIO()
    print_report(studied(1000.0), "fern", Console(file=out, width=80))
    shown = out.getvalue()
    assert "What each regularizer adds: fern, 4 training views" in shown
    rows = {line.split()[0]: line.split() for line in shown.splitlines() if line.split()}
    assert rows["kl:"][1] == "helps" and float(rows["kl:"][3]) > 0.5
    assert rows["lipschitz:"][1] == "hurts"
    assert "confirmed, not worse by more than 0.1 dB." in shown
    assert "Pruned set: kl. Dropped: lipschitz." in shown
    assert "--budget" not in shown  # Nothing is open.
    assert max(map(len, shown.partition("kl:")[0].splitlines())) <= 80


def test_what_cannot_be_told_names_a_budget() -> None:
    lines = list(conclusions(studied(0.5)))
    assert lines[:2] == ["kl: cannot tell: too few cells", "lipschitz: cannot tell: too few cells"]
    assert lines[2] == "There was no time to confirm a smaller set: every regularizer stays."
    assert lines[3].startswith("To tell more, a budget of about ")


def test_the_record_is_written_as_strict_json() -> None:
    again = json.loads(json_text(record(studied(0.5))))
    assert again["contributions"][0]["gain"]["low"] is None  # It is infinite.
    assert again["contributions"][0]["verdict"] == "cannot tell"
    assert again["trials"][0]["regularizers"] == ["kl", "lipschitz"]
    assert again["budget_needed"] > 0


def test_numbers_in_words() -> None:
    assert ends(Interval(0.1, -0.1, 0.3, 4, 0.1)) == "-0.10..+0.30"
    assert ends(Interval(0.1, -0.1, 0.3, 4, 0.1), 100.0, 0) == "-10..+30"
    assert ends(Interval(0.1, -math.inf, math.inf, 1, math.nan)) == "?"
    assert [duration(seconds) for seconds in (60, 7140, 9000)] == ["1 min", "119 min", "2.5 h"]


def test_sentences() -> None:
    def sentence(low: float, high: float, count: int = 6) -> str:
        gain = Interval((low + high) / 2, low, high, count, 0.1)
        return finding_sentence(Difference(10, 0.01, gain, gain), 0.1)

    assert sentence(0.2, 0.9) == "helps by 0.20 to 0.90 dB"
    assert sentence(-0.9, -0.2) == "hurts by 0.20 to 0.90 dB"
    assert sentence(-0.05, 0.02) == "makes no difference beyond 0.1 dB (-0.05 to +0.02 dB)"
    assert sentence(-0.5, 0.2).startswith("cannot tell (-0.50 to +0.20 dB); ")
    assert sentence(-math.inf, math.inf, 1) == "cannot tell: too few cells"
