"""What a study that could not tell would probably need."""

from __future__ import annotations

import math

from nerfreg.analysis.statistics import cells_needed
from nerfreg.prune.ledger import Difference
from nerfreg.prune.plan import Context, Selection, Stage, Trial
from nerfreg.prune.study import CONTRIBUTIONS_SHARE, Study, StudyResult
from nerfreg.prune.verdicts import Verdict, judge, no_worse

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
    half = max(mean, tolerance - mean)
    return cells_needed(found.gain.deviation, half, found.error / LATER_LOOKS)


def budget_needed(study: Study, result: StudyResult) -> int | None:
    """Estimate the seconds that would do for what was left open; None: nothing was, or none would.

    Args:
        study: The study, after it ran.
        result: What it found.
    """
    design, ledger = study.design, study.ledger
    judging: dict[Trial, None] = {}
    for name, found in result.findings[Context.SET].items():
        if judge(found.gain, study.tolerance) is Verdict.CANNOT_TELL:
            judging |= dict.fromkeys(_to_judge(study, design.pair(name, Context.SET), found))
    total = (ledger.spent + ledger.cost(judging)) / CONTRIBUTIONS_SHARE if judging else 0.0
    if result.pruned == design.full and len(result.proposals) > 1:
        # A proposal may take half of what is left, unless it is the only one.
        left = _to_confirm(study, result) * (2 if len(result.proposals) > 2 else 1)
        if left:
            total = max(total, left / (1 - CONTRIBUTIONS_SHARE) if judging else ledger.spent + left)
    return GRAIN * math.ceil(max(total, LEAST_GROWTH * study.budget) / GRAIN) if total else None


def _to_judge(study: Study, sets: tuple[Selection, Selection], found: Difference) -> list[Trial]:
    """Return the trials of a longer study: trainings become longer before there are more."""
    design = study.design
    if found.gain.count < 2:
        return design.trials(sets, Stage(found.steps, design.first_look))
    cells = cells_to_judge(found, study.tolerance)
    if cells is None:
        return []
    climb = [Stage(steps, design.first_look) for steps in design.ladder[:-1] if steps > found.steps]
    stages = [*climb, Stage(design.ladder[-1], cells)]
    return [trial for stage in stages for trial in design.trials(sets, stage)]


def _to_confirm(study: Study, result: StudyResult) -> float:
    """Return the seconds of the cheapest confirmation that is still open; 0 if none is."""
    design, tolerance = study.design, study.tolerance

    def cost(proposal: Selection, cells: int) -> float:
        stage = Stage(design.ladder[-1], cells)
        return study.ledger.cost(design.trials((design.full, proposal), stage))

    if not result.confirmations:
        return cost(result.proposals[0], design.first_look)
    needed = {
        proposal: cells_needed(
            found.gain.deviation, found.gain.mean + tolerance, found.error / LATER_LOOKS
        )
        for proposal, found in result.confirmations.items()
        if no_worse(found.gain, tolerance) is None
    }
    costs = [cost(proposal, cells) for proposal, cells in needed.items() if cells is not None]
    return min(costs, default=0.0)
