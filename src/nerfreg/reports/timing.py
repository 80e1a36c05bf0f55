"""How long it takes: training seconds to a PSNR, and seconds per step beside vanilla's."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from nerfreg.reports.methods import identity
from nerfreg.reports.records import VANILLA, NamedRun, by_method, by_setting, counted, grouped
from nerfreg.reports.tables import NOT_REACHED, Column, Row, Table, TableCell, marked, mean_of
from nerfreg.runs.records import EvaluationRecord

COLUMNS = (
    Column("step", "ms", ".1f", "down", "milliseconds_per_step"),
    Column("relative to vanilla", "", ".2f", "down", "relative_to_vanilla"),
)
NOTE = (
    "Medians over runs. Vanilla has the same settings and threads, and a budget of the same kind."
)


class Crossing(NamedTuple):
    """When a PSNR was reached, or at most, where the first evaluation was already above."""

    seconds: float
    at_most: bool = False


def seconds_to_psnr(evaluations: Sequence[EvaluationRecord], psnr: float) -> Crossing | None:
    """Return when the PSNR was reached for the first time; None if it never was.

    Between two evaluations PSNR is taken to be linear in the logarithm of time.
    """
    below: tuple[float, float] | None = None
    for evaluation in evaluations:
        seconds, value = evaluation.train_seconds, evaluation.psnr
        if value is None or seconds <= 0:
            continue
        if value >= psnr:
            if below is None:
                return Crossing(seconds, at_most=True)
            share = (psnr - below[1]) / (value - below[1])
            return Crossing(math.exp(math.log(below[0]) + share * math.log(seconds / below[0])))
        below = seconds, value
    return None


def mean_seconds_to_psnr(runs: Sequence[NamedRun], psnr: float) -> TableCell:
    """Return the mean time to a PSNR.

    There is none where some run never gets there, for the mean of the others says too little.
    """
    found = [seconds_to_psnr(run.evaluations, psnr) for run in runs]
    times = [crossing for crossing in found if crossing is not None]
    if len(times) < len(found):
        some = f"reached by {len(times)} of {len(found)}"
        return TableCell(text=some if times else NOT_REACHED)
    mean = mean_of(crossing.seconds for crossing in times)
    return replace(mean, at_most=any(crossing.at_most for crossing in times))


def cost_tables(runs: Sequence[NamedRun]) -> list[Table]:
    """Return what a step of each method takes, for each setting that has more than one method.

    A method is compared with vanilla runs that agree with it in all but regularizers, seed and the
    size of the budget, for each number of threads.
    """
    timed = [run for run in runs if run.failure is None and run.last and run.last.step > 0]
    tables = []
    for setting, own in by_setting(timed).items():
        if len(by_method(own)) > 1:
            alike = len({run.threads for run in own}) == 1
            notes = (NOTE, f"Trained with {_threads(own[0])}.") if alike else (NOTE,)
            title, name = f"Cost of a step: {setting.title}", f"cost-{setting.name}"
            rows = marked(COLUMNS, _cost_rows(own))
            tables.append(Table(title, name, COLUMNS, rows, "runs", notes))
    return tables


def _cost_rows(runs: Sequence[NamedRun]) -> list[Row]:
    vanilla = grouped((run for run in runs if identity(run)["reg"] == VANILLA), _conditions)
    several = len({run.threads for run in runs}) > 1
    rows = []
    for (method, _), group in grouped(runs, lambda run: (run.method, run.threads)).items():
        median = _milliseconds(group)
        # Of one method all runs have the same conditions, but for keys that older folders lack.
        conditions = [_conditions(run) for run in group]
        matched = all(each in vanilla for each in conditions)
        relative = median / _milliseconds(vanilla[conditions[0]]) if matched else None
        label = (
            f"{method}, {_threads(group[0])}" if several and "threads=" not in method else method
        )
        cells = tuple(TableCell(value, count=len(group)) for value in (median, relative))
        rows.append(Row(label, cells, len(group)))
    return sorted(rows, key=lambda row: row.cells[0].value or 0.0)


def _milliseconds(runs: Sequence[NamedRun]) -> float:
    lasts = [run.last for run in runs if run.last]
    return float(statistics.median(1e3 * last.train_seconds / last.step for last in lasts))


def _threads(run: NamedRun) -> str:
    return "threads unknown" if run.threads is None else counted(run.threads, "thread")


def _conditions(run: NamedRun) -> tuple[tuple[str, str], ...]:
    """Return all that may change the time of a step, regularizers aside."""
    known = {key: value for key, value in identity(run).items() if key.split(".")[0] != "reg"}
    known["threads"] = str(run.threads)
    known["budget"] = "seconds" if run.settings.get("train.seconds") is not None else "steps"
    return tuple(sorted(known.items()))
