"""What a study that could not tell would probably need."""

from __future__ import annotations

import math

from nerfreg.analysis.statistics import cells_needed
from nerfreg.prune.ledger import Difference, Verdict
from nerfreg.prune.plan import Context, Selection, Stage, Trial
from nerfreg.prune.study import CONTRIBUTIONS_SHARE, Study

GRAIN = 60
"""Budgets are estimates, and given in whole minutes."""

LEAST_GROWTH = 1.5
"""A budget that was not enough is at least multiplied by this."""

LATER_LOOKS = 5
"""Looks still to come may miss this many times less often than the last (`error_of_look`)."""


def cells_to_judge(found: Difference, tolerance: float) -> int | None:
    """Estimate how many cells would settle a finding; None: too many.

    If mean and deviation are what they seem, it is settled when its interval is clear of 0 or fits
    into the tolerance, whichever is nearer.
    """
    mean = abs(found.gain.mean)
    return _cells(found, max(mean, tolerance - mean))


def _cells(found: Difference, half: float) -> int | None:
    return cells_needed(found.gain.deviation, half, found.error / LATER_LOOKS)


def budget_needed(study: Study) -> int | None:
    """Estimate the seconds that settle what is open; None: nothing is open, or nothing would."""
    spent, full = study.ledger.spent, study.design.full
    judging = {
        trial
        for name, found in study.findings[Context.SET].items()
        if found.verdict(study.tolerance) is Verdict.CANNOT_TELL
        for trial in _to_judge(study, name, found)
    }
    total = (spent + study.ledger.cost(judging)) / CONTRIBUTIONS_SHARE if judging else 0.0
    if study.pruned == full and len(study.proposals) > 1:
        # A proposal may take half of what is left, unless it is the only one.
        left = _to_confirm(study) * (2 if len(study.proposals) > 2 else 1)
        if left:
            total = max(total, left / (1 - CONTRIBUTIONS_SHARE) if judging else spent + left)
    return GRAIN * math.ceil(max(total, LEAST_GROWTH * study.budget) / GRAIN) if total else None


def _to_judge(study: Study, name: str, found: Difference) -> list[Trial]:
    """Return the trials of a longer study: trainings become longer before there are more."""
    design = study.design
    stages = [Stage(found.steps, design.first_look)]
    if found.gain.count > 1:
        cells = cells_to_judge(found, study.tolerance)
        if cells is None:
            return []
        longer = [steps for steps in design.ladder[:-1] if steps > found.steps]
        stages = [Stage(steps, design.first_look) for steps in longer]
        stages.append(Stage(design.ladder[-1], cells))
    pair = design.pair(name, Context.SET)
    return [trial for stage in stages for trial in design.trials([pair], stage)]


def _to_confirm(study: Study) -> float:
    """Return the seconds of the cheapest confirmation that is still open; 0 if none is."""
    design = study.design

    def cost(proposal: Selection, cells: int) -> float:
        stage = Stage(design.ladder[-1], cells)
        return study.ledger.cost(design.trials([(proposal, design.full)], stage))

    if not study.confirmations:
        return cost(study.proposals[0], design.first_look)
    costs = [
        cost(proposal, cells)
        for proposal, found in study.confirmations.items()
        if found.no_worse(study.tolerance) is None
        and (cells := _cells(found, found.gain.mean + study.tolerance)) is not None
    ]
    return min(costs, default=0.0)
