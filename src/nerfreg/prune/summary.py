"""What a study comes to, before it is put into words."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import fmean

from nerfreg.analysis.pareto import front
from nerfreg.analysis.statistics import ERROR, Interval, interval
from nerfreg.prune.advice import budget_needed
from nerfreg.prune.ledger import Ledger
from nerfreg.prune.plan import Design, Selection
from nerfreg.prune.study import Outcome


@dataclass(frozen=True)
class SetPoint:
    """One set against the full one, over the cells on which both have been trained for this many steps.

    gain: in dB. time: of a step, as a share. average: mean change; None where unknown. Plain 95 % intervals.
    """

    regularizers: Selection
    steps: int
    gain: Interval
    time: Interval
    average: float | None
    on_front: bool = False


@dataclass(frozen=True)
class Summary:
    """Everything that a report needs. scene: its name. views: training views. budget: seconds."""

    scene: str
    views: int
    design: Design
    ledger: Ledger
    outcome: Outcome
    tolerance: float
    budget: float

    @property
    def advice(self) -> int | None:
        return budget_needed(self.design, self.ledger, self.outcome, self.tolerance, self.budget)


def set_points(design: Design, ledger: Ledger) -> list[SetPoint]:
    """Every set that was trained, for each number of steps: the longest trainings first, of these the best first.

    On the Pareto front is what nothing of as many steps beats: sets that look good early often do not in the end.
    """
    points: list[SetPoint] = []
    for steps in reversed(design.ladder):
        trained = dict.fromkeys(
            trial.regularizers for trial in ledger.trials if trial.steps == steps
        )
        level = [
            point
            for names in trained
            if (point := _point(design, ledger, names, steps)) is not None
        ]
        best = front([(-point.gain.mean, point.time.mean) for point in level])
        level = [replace(point, on_front=index in best) for index, point in enumerate(level)]
        points += sorted(level, key=lambda point: -point.gain.mean)
    return points


def _point(design: Design, ledger: Ledger, names: Selection, steps: int) -> SetPoint | None:
    cells = [
        trial.cell
        for trial in ledger.trials
        if trial.regularizers == names and trial.steps == steps
    ]
    pair = (names, design.full, cells, steps)
    if not (gains := ledger.gains(*pair)):
        return None
    times, averages = ledger.extra_times(*pair), ledger.average_changes(*pair)
    average = fmean(averages) if averages else None
    return SetPoint(names, steps, interval(gains, ERROR), interval(times, ERROR), average)
