from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from nerfreg.analysis.statistics import Interval
from nerfreg.errors import NerfregError
from nerfreg.prune.ledger import Difference, Ledger, Measurement, Verdict
from nerfreg.prune.plan import Trial

CELL, OTHER_CELL = ((0, 4), 3), ((1,), 3)
TRIAL = Trial(("kl", "lipschitz"), *CELL, 50)


class Recorder:
    """Measures by counting."""

    def __init__(self) -> None:
        self.asked: list[Trial] = []

    def __call__(self, trial: Trial) -> Measurement:
        self.asked.append(trial)
        return Measurement(20.0 + len(self.asked), 0.1, 0.01, 2.0)


def measured(ledger: Ledger, trial: Trial) -> Measurement:
    ledger.add(trial)
    return ledger.trials[trial]


def test_what_is_measured_is_never_measured_again(tmp_path: Path) -> None:
    path, first, second = tmp_path / "new" / "cells.jsonl", Recorder(), Recorder()
    own = measured(Ledger(first, path, "f"), TRIAL)
    again = Ledger(second, path, "f")
    assert measured(again, TRIAL) == own and not second.asked and again.reused == 1
    for other in (
        Trial((), *CELL, 50),
        Trial(TRIAL.regularizers, *OTHER_CELL, 50),
        Trial(TRIAL.regularizers, *CELL, 51),
    ):
        again.add(other)
    assert len(second.asked) == 3


def test_another_configuration_is_measured_anew_and_loses_nothing(tmp_path: Path) -> None:
    path, first, second, third = tmp_path / "cells.jsonl", Recorder(), Recorder(), Recorder()
    Ledger(first, path, "f").add(TRIAL)
    Ledger(second, path, "g").add(TRIAL)
    Ledger(third, path, "f").add(TRIAL)
    assert (len(first.asked), len(second.asked), len(third.asked)) == (1, 1, 0)


def test_a_line_that_was_not_finished_costs_one_training(tmp_path: Path) -> None:
    path, other = tmp_path / "cells.jsonl", Trial((), *OTHER_CELL, 50)
    ledger = Ledger(Recorder(), path, "f")
    ledger.add(TRIAL)
    ledger.add(other)
    path.write_text(path.read_text()[:-20])
    again = Recorder()
    resumed = Ledger(again, path, "f")
    resumed.add(TRIAL)
    resumed.add(other)
    assert again.asked == [other]
    lines = path.read_text().splitlines()
    assert len(lines) == 3
    assert json.loads(lines[2])["held_out"] == [1]  # It is on a line of its own.


def test_a_failure_is_remembered(tmp_path: Path) -> None:
    path = tmp_path / "cells.jsonl"
    failed = Measurement(None, None, 0.01, 1.0, "3 steps in a row were not finite")
    Ledger(lambda trial: failed, path, "f").add(TRIAL)
    again = Recorder()
    assert measured(Ledger(again, path, "f"), TRIAL) == failed and not again.asked


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(NerfregError, match=r"file/cells\.jsonl: cannot be written"):
        Ledger(Recorder(), tmp_path / "file" / "cells.jsonl", "f").add(TRIAL)


def test_cost() -> None:
    # 2 s of loading and scoring, 10 ms a step for vanilla; 1 s and 20 ms for the other set.
    def measure(trial: Trial) -> Measurement:
        loading, step = (1.0, 0.02) if trial.regularizers else (2.0, 0.01)
        return Measurement(20.0, None, step, loading + trial.steps * step)

    ledger = Ledger(measure)
    vanilla = Trial((), *CELL, 100)
    assert ledger.cost([vanilla]) == 0.0
    ledger.add(vanilla)
    assert ledger.spent == pytest.approx(3.0)
    assert ledger.cost([vanilla]) == 0.0
    assert ledger.cost([Trial((), *OTHER_CELL, 100), Trial((), *OTHER_CELL, 300)]) == pytest.approx(
        3.0 + 5.0
    )
    assert ledger.cost([TRIAL]) == pytest.approx(2.5)  # as the only set that is known
    ledger.add(TRIAL)
    assert ledger.cost([Trial(TRIAL.regularizers, *OTHER_CELL, 200)]) == pytest.approx(5.0)
    assert ledger.spent == pytest.approx(5.0)


def test_differences_are_paired_by_cell() -> None:
    values = {
        Trial(("a",), *CELL, 10): Measurement(21.0, 0.05, 0.012, 1.0),
        Trial((), *CELL, 10): Measurement(20.5, 0.06, 0.010, 1.0),
        Trial(("a",), *OTHER_CELL, 10): Measurement(30.0, None, 0.012, 1.0),
        Trial((), *OTHER_CELL, 10): Measurement(None, None, 0.010, 1.0, "failed"),
        Trial(("a",), *CELL, 20): Measurement(40.0, None, 0.012, 1.0),
    }
    ledger = Ledger(values.__getitem__)
    for trial in values:
        ledger.add(trial)
    cells = [CELL, OTHER_CELL, ((7,), 0)]
    found = ledger.difference(("a",), (), cells, 10, 0.05)
    assert (found.steps, found.error, found.gain.count, found.gain.mean) == (10, 0.05, 1, 0.5)
    assert (found.time.count, found.time.mean) == (1, pytest.approx(0.2))
    assert found.average == pytest.approx(-0.01)
    alone = ledger.difference(("a",), (), cells, 20, 0.05)
    assert (alone.gain.count, alone.time.count, alone.average) == (0, 0, None)


def gaining(low: float, high: float) -> Difference:
    gain = Interval((low + high) / 2, low, high, 6, 0.1)
    return Difference(10, 0.01, gain, gain)


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (0.2, 0.9, Verdict.HELPS),
        (0.02, 0.9, Verdict.HELPS),
        (0.02, 0.09, Verdict.NO_DIFFERENCE),  # It is certain, and too little to matter.
        (-0.1, 0.1, Verdict.NO_DIFFERENCE),
        (-0.1, 0.11, Verdict.CANNOT_TELL),
        (0.0, 0.5, Verdict.CANNOT_TELL),
        (-0.5, -0.01, Verdict.HURTS),
        (-0.09, -0.01, Verdict.NO_DIFFERENCE),
        (-math.inf, math.inf, Verdict.CANNOT_TELL),
    ],
)
def test_verdict(low: float, high: float, verdict: Verdict) -> None:
    assert gaining(low, high).verdict(0.1) is verdict


@pytest.mark.parametrize(
    ("low", "high", "passed"),
    [
        (-0.1, 0.5, True),
        (0.2, 0.5, True),
        (-0.5, -0.11, False),
        (-0.5, -0.1, None),
        (-0.11, 0.5, None),
        (-math.inf, math.inf, None),
    ],
)
def test_no_worse(low: float, high: float, passed: bool | None) -> None:
    assert gaining(low, high).no_worse(0.1) is passed
