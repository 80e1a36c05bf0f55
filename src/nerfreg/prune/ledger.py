"""What has been measured: in memory for the study, and on disk so that a stop costs one training."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean

from nerfreg.errors import NerfregError
from nerfreg.prune.plan import Cell, Selection, Trial

CELLS = "cells.jsonl"


@dataclass(frozen=True)
class Measurement:
    """psnr, average: on the held-out views; None where unknown. step_seconds: mean training time of a step, and its
    share, in a whole run, of what comes before the first. seconds: of the whole trial, with loading and scoring.
    failure: why it ended early, if it did."""

    psnr: float | None
    average: float | None
    step_seconds: float
    seconds: float
    failure: str | None = None


Measure = Callable[[Trial], Measurement]


class CellFile:
    """A measure that keeps what it has measured in FOLDER/cells.jsonl, one line a trial, and never measures it again.

    fingerprint: of everything else that a measurement depends on; lines with another are left alone.
    reused: trials that were found there.
    """

    def __init__(self, folder: Path, fingerprint: str, measure: Measure) -> None:
        self.path = folder / CELLS
        self.reused = 0
        self._fingerprint = fingerprint
        self._measure = measure
        self._known = dict(self._read())

    def __call__(self, trial: Trial) -> Measurement:
        if trial in self._known:
            self.reused += 1
            return self._known[trial]
        measurement = self._measure(trial)
        self._known[trial] = measurement
        self._append(trial, measurement)
        return measurement

    def _read(self) -> Iterable[tuple[Trial, Measurement]]:
        if not self.path.is_file():
            return
        for line in self.path.read_text(encoding="utf-8").splitlines():
            try:
                record = json.loads(line)
                if record.pop("fingerprint") != self._fingerprint:
                    continue
                names, held_out = tuple(record.pop("regularizers")), tuple(record.pop("held_out"))
                trial = Trial(names, Cell(held_out, record.pop("seed")), record.pop("steps"))
                yield trial, Measurement(**record)
            except (ValueError, KeyError, TypeError, AttributeError):
                continue  # a line that was not finished when the program was stopped

    def _append(self, trial: Trial, measurement: Measurement) -> None:
        record = {"fingerprint": self._fingerprint, **flat(trial), **asdict(measurement)}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a+b") as file:
                # behind a line that was not finished
                torn = file.tell() > 0 and (file.seek(-1, 2), file.read(1))[1] != b"\n"
                file.write(b"\n" * torn + json.dumps(record, allow_nan=False).encode() + b"\n")
        except OSError as error:
            raise NerfregError(
                f"{self.path}: cannot be written ({error.strerror or error})"
            ) from error


def flat(trial: Trial) -> dict[str, object]:
    """A trial as it stands in files."""
    return {
        "regularizers": list(trial.regularizers),
        "held_out": list(trial.cell.held_out),
        "seed": trial.cell.seed,
        "steps": trial.steps,
    }


class Ledger:
    """All trials of a study, what they have cost, and what others would cost.

    spent: seconds of all trials, by their own account: a study that is started again decides as it did before.
    """

    def __init__(self, measure: Measure) -> None:
        self.trials: dict[Trial, Measurement] = {}
        self.spent = 0.0
        self._measure = measure
        self._whole: dict[tuple[Selection, int], list[Measurement]] = {}

    def add(self, trial: Trial) -> None:
        """Measure a trial, unless it has been."""
        if trial in self.trials:
            return
        measurement = self._measure(trial)
        self.trials[trial] = measurement
        self.spent += measurement.seconds
        if measurement.failure is None:
            self._whole.setdefault((trial.regularizers, trial.steps), []).append(measurement)

    def cost(self, trials: Iterable[Trial]) -> float:
        """Seconds that those of the trials would take, probably, that have not been measured; 0 if nothing has."""
        missing = Counter(
            (trial.regularizers, trial.steps) for trial in trials if trial not in self.trials
        )
        return math.fsum(
            count * self._cost(names, steps) for (names, steps), count in missing.items()
        )

    def _cost(self, regularizers: Selection, steps: int) -> float:
        """By the trials of the same set, or the costliest of all; loading and scoring take as long for any length."""
        if same := self._whole.get((regularizers, steps)):
            return fmean(m.seconds for m in same)
        scaled = {
            (names, own): fmean(m.seconds + (steps - own) * m.step_seconds for m in measured)
            for (names, own), measured in self._whole.items()
        }
        same_set = [seconds for (names, _), seconds in scaled.items() if names == regularizers]
        return max(same_set or scaled.values(), default=0.0)

    def gains(
        self, first: Selection, second: Selection, cells: Sequence[Cell], steps: int
    ) -> list[float]:
        """PSNR of the first set minus that of the second, over the cells on which both have one."""
        return [a - b for a, b in self._pairs(first, second, cells, steps, lambda m: m.psnr)]

    def average_changes(
        self, first: Selection, second: Selection, cells: Sequence[Cell], steps: int
    ) -> list[float]:
        """`average` of the first set minus that of the second, over the cells on which both have one."""
        return [a - b for a, b in self._pairs(first, second, cells, steps, lambda m: m.average)]

    def extra_times(
        self, first: Selection, second: Selection, cells: Sequence[Cell], steps: int
    ) -> list[float]:
        """How much longer a step of the first set takes than one of the second, as a share, over the same cells."""
        return [a / b - 1 for a, b in self._pairs(first, second, cells, steps, _time_of_whole)]

    def _pairs(
        self,
        first: Selection,
        second: Selection,
        cells: Sequence[Cell],
        steps: int,
        value: Callable[[Measurement], float | None],
    ) -> list[tuple[float, float]]:
        pairs = []
        for cell in cells:
            one, other = (self.trials.get(Trial(names, cell, steps)) for names in (first, second))
            if one is None or other is None:
                continue
            a, b = value(one), value(other)
            if a is not None and b is not None:
                pairs.append((a, b))
        return pairs


def _time_of_whole(measurement: Measurement) -> float | None:
    """Time of a step, of a training that did not end early."""
    return None if measurement.psnr is None else measurement.step_seconds
