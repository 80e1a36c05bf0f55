"""What a study comes to, before it is put into words."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import fmean

from nerfreg.prune.advice import budget_needed
from nerfreg.prune.ledger import Ledger
from nerfreg.prune.plan import Design, Selection
from nerfreg.prune.statistics import ERROR, Interval, interval
from nerfreg.prune.study import Outcome
from nerfreg.reports.pareto import front


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
    """Every set that was trained, at its longest trainings, the best first, and which are on the Pareto front."""
    points = []
    for names in dict.fromkeys(trial.regularizers for trial in ledger.trials):
        for steps in reversed(design.ladder):
            cells = [trial.cell for trial in ledger.trials if trial.regularizers == names and trial.steps == steps]
            pair = (names, design.full, cells, steps)
            if gains := ledger.gains(*pair):
                times, averages = ledger.extra_times(*pair), ledger.average_changes(*pair)
                average = fmean(averages) if averages else None
                points.append(SetPoint(names, steps, interval(gains, ERROR), interval(times, ERROR), average))
                break
    best = front([(-point.gain.mean, point.time.mean) for point in points])
    points = [replace(point, on_front=index in best) for index, point in enumerate(points)]
    return sorted(points, key=lambda point: -point.gain.mean)
