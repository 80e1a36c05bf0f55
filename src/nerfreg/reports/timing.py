"""How long it takes: training seconds to a given PSNR, and seconds per step of each method beside vanilla."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from nerfreg.reports.grouping import Setting, by_setting
from nerfreg.reports.methods import VANILLA, identity
from nerfreg.reports.records import Evaluation, RunRecord


@dataclass(frozen=True)
class Crossing:
    """seconds: of training. at_most: the first evaluation was already above, so that it may have been earlier."""

    seconds: float
    at_most: bool = False


@dataclass(frozen=True)
class Cost:
    """What a step of a method takes.

    seconds_per_step: median over `runs` runs. relative: to vanilla with the same settings; None without such a run.
    """

    setting: Setting
    method: str
    threads: int | None
    seconds_per_step: float
    relative: float | None
    runs: int


def seconds_to_psnr(evaluations: Sequence[Evaluation], psnr: float) -> Crossing | None:
    """When the PSNR was reached for the first time; None if it never was.

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


def costs(records: Sequence[RunRecord]) -> list[Cost]:
    """Seconds per step of every method on every scene, for each number of threads.

    A method is compared with vanilla runs that agree with it in all but regularizers, seed and the size of the budget.
    """
    found = []
    for setting, runs in by_setting(records).items():
        timed = [(run, seconds) for run in runs if (seconds := _seconds_per_step(run)) is not None]
        plain: dict[object, list[float]] = {}
        groups: dict[tuple[str, int | None], list[tuple[object, float]]] = {}
        for run, seconds in timed:
            conditions = _conditions(run)
            groups.setdefault((run.method, run.threads), []).append((conditions, seconds))
            if identity(run)["reg"] == VANILLA:
                plain.setdefault(conditions, []).append(seconds)
        for (method, threads), group in groups.items():
            median = statistics.median(seconds for _, seconds in group)
            matched = [conditions for conditions, _ in group if conditions in plain]
            relative = None
            if len(matched) == len(group):
                # Of one method all runs have the same conditions, but for keys that older folders lack.
                relative = median / statistics.median(plain[matched[0]])
            found.append(Cost(setting, method, threads, median, relative, len(group)))
    return found


def _seconds_per_step(run: RunRecord) -> float | None:
    last = run.evaluations[-1] if run.evaluations else None
    return (
        last.train_seconds / last.step
        if last is not None and last.step > 0 and run.failure is None
        else None
    )


def _conditions(run: RunRecord) -> tuple[tuple[str, str], ...]:
    """What a method is compared under: all that may change the time of a step, regularizers aside."""
    known = {
        key: value
        for key, value in identity(run).items()
        if key != "reg" and not key.startswith("reg.")
    }
    known["threads"] = str(run.threads)
    known["budget"] = "seconds" if run.settings.get("train.seconds") is not None else "steps"
    return tuple(sorted(known.items()))
