"""What a study has measured, in memory and on disk, and what sets are compared by."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from statistics import fmean

from nerfreg.analysis.statistics import Interval, interval
from nerfreg.files import append_json_line, write_text
from nerfreg.prune.plan import Selection, StudyCell, Trial


@dataclass(frozen=True)
class Measurement:
    """What a trial yields.

    Attributes:
        psnr: Of the held-out views, dB; None if training failed.
        average: Of the held-out views; None where unknown.
        step_seconds: Time of a step, with its share, in a whole run, of what precedes the first.
        seconds: Time of the whole trial, loading and scoring included.
        failure: Why training ended early; None if it did not.
    """

    psnr: float | None
    average: float | None
    step_seconds: float
    seconds: float
    failure: str | None = None


class Verdict(StrEnum):
    """What can be said of a regularizer's contribution."""

    HELPS = "helps"
    HURTS = "hurts"
    NO_DIFFERENCE = "no difference"
    CANNOT_TELL = "cannot tell"


@dataclass(frozen=True)
class Difference:
    """One set minus another, over the cells on which both were trained to the end.

    Attributes:
        steps: Length of the trainings.
        error: The probability with which each interval may miss.
        gain: PSNR, dB.
        time: How much longer a step takes, as a share.
        average: Mean change of `average`; None where unknown.
    """

    steps: int
    error: float
    gain: Interval
    time: Interval
    average: float | None = None

    def verdict(self, tolerance: float) -> Verdict:
        """Judge the gain; one that is certain but within the tolerance, in dB, is none."""
        if self.gain.inside(tolerance):
            return Verdict.NO_DIFFERENCE
        if self.gain.low > 0:
            return Verdict.HELPS
        return Verdict.HURTS if self.gain.high < 0 else Verdict.CANNOT_TELL

    def no_worse(self, tolerance: float) -> bool | None:
        """Return whether the first set may replace the second; None: cannot tell."""
        if self.gain.low >= -tolerance:
            return True
        return False if self.gain.high < -tolerance else None


class Ledger:
    """All trials of a study, what they cost, and what others would cost.

    Args:
        measure: Measures a trial.
        path: Keeps every measurement, one line each, so that none is made twice; None: no file.
        fingerprint: Stands for all else that a measurement depends on; lines with another are kept
            and not used.

    Attributes:
        trials: What was asked for, in order.
        reused: How many of these were found in the file.
        spent: Seconds of all trials. Counted by their own account and not by the clock, so that a
            study that is started again decides as it did before.
    """

    def __init__(
        self,
        measure: Callable[[Trial], Measurement],
        path: Path | None = None,
        fingerprint: str = "",
    ) -> None:
        self.trials: dict[Trial, Measurement] = {}
        self.reused = 0
        self.spent = 0.0
        self._measure = measure
        self._path = path
        self._fingerprint = fingerprint
        text = path.read_text(encoding="utf-8") if path and path.is_file() else ""
        if path and text and not text.endswith("\n"):
            # The program was stopped while it wrote this line; the next one must not continue it.
            write_text(path, text + "\n")
        self._saved = dict(_parsed(text, fingerprint))
        self._whole: dict[tuple[Selection, int], list[Measurement]] = {}

    def add(self, trial: Trial) -> None:
        """Measure a trial that is not in the ledger, or find it in the file.

        Raises:
            NerfregError: The file cannot be written.
        """
        if trial in self._saved:
            self.reused += 1
            measurement = self._saved[trial]
        else:
            measurement = self._measure(trial)
            if self._path:
                line = {"fingerprint": self._fingerprint, **asdict(trial), **asdict(measurement)}
                append_json_line(self._path, line)
        self.trials[trial] = measurement
        self.spent += measurement.seconds
        if measurement.failure is None:
            self._whole.setdefault((trial.regularizers, trial.steps), []).append(measurement)

    def cost(self, trials: Iterable[Trial]) -> float:
        """Estimate the seconds of those trials that are not measured yet; 0 if nothing is."""
        missing = Counter((t.regularizers, t.steps) for t in trials if t not in self.trials)
        return math.fsum(count * self._cost(*kind) for kind, count in missing.items())

    def _cost(self, regularizers: Selection, steps: int) -> float:
        if same := self._whole.get((regularizers, steps)):
            return fmean(m.seconds for m in same)
        # Loading and scoring take as long for any number of steps.
        scaled = {
            (names, own): fmean(m.seconds + (steps - own) * m.step_seconds for m in measured)
            for (names, own), measured in self._whole.items()
        }
        same_set = [seconds for (names, _), seconds in scaled.items() if names == regularizers]
        return max(same_set or scaled.values(), default=0.0)

    def difference(
        self,
        first: Selection,
        second: Selection,
        cells: Iterable[StudyCell],
        steps: int,
        error: float,
    ) -> Difference:
        """Subtract the second set from the first, cell by cell."""
        gains, times, averages = [], [], []
        for cell in cells:
            one, other = (self.trials.get(Trial(names, *cell, steps)) for names in (first, second))
            if one is None or other is None or one.psnr is None or other.psnr is None:
                continue
            gains.append(one.psnr - other.psnr)
            times.append(one.step_seconds / other.step_seconds - 1)
            if one.average is not None and other.average is not None:
                averages.append(one.average - other.average)
        average = fmean(averages) if averages else None
        return Difference(steps, error, interval(gains, error), interval(times, error), average)


def _parsed(text: str, fingerprint: str) -> Iterator[tuple[Trial, Measurement]]:
    for line in text.splitlines():
        try:
            record = json.loads(line)
            if record.pop("fingerprint") != fingerprint:
                continue
            names, held_out = tuple(record.pop("regularizers")), tuple(record.pop("held_out"))
            trial = Trial(names, held_out, record.pop("seed"), record.pop("steps"))
            yield trial, Measurement(**record)
        except (ValueError, KeyError, TypeError, AttributeError):
            continue  # The line was not finished when the program was stopped.
