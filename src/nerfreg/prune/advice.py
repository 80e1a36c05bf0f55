"""What a study that could not tell would probably need."""

from __future__ import annotations

import math

from nerfreg.analysis.statistics import cells_needed
from nerfreg.prune.ledger import Ledger
from nerfreg.prune.plan import Design, Selection, Trial
from nerfreg.prune.study import CONTRIBUTIONS_SHARE, Confirmation, Outcome
from nerfreg.prune.verdicts import Finding, Verdict

GRAIN = 60
"""Budgets are guesses, and named in whole minutes."""

LEAST_GROWTH = 1.5
"""Of the budget that was not enough."""

LATER_LOOKS = 5
"""Looks still to come may miss this many times less often than the last one did (`error_of_look`)."""


def cells_to_judge(finding: Finding, tolerance: float) -> int | None:
    """How many cells would settle an undecided finding if its mean and its spread are what they seem; None: too many.

    It is settled when the interval is clear of 0, or fits into the tolerance, whichever is nearer.
    """
    mean = abs(finding.gain.mean)
    return cells_needed(
        finding.gain.deviation, max(mean, tolerance - mean), finding.error / LATER_LOOKS
    )


def cells_to_confirm(confirmation: Confirmation, tolerance: float) -> int | None:
    """How many cells would let an undecided confirmation pass; None: too many, or it seems to be worse."""
    gain = confirmation.gain
    return cells_needed(gain.deviation, gain.mean + tolerance, confirmation.error / LATER_LOOKS)


def budget_needed(
    design: Design, ledger: Ledger, outcome: Outcome, tolerance: float, budget: float
) -> int | None:
    """Seconds that would probably do for what a study of this budget left open; None: nothing would, or is open."""
    judging: dict[Trial, None] = {}
    for finding in outcome.contributions:
        if finding.verdict is Verdict.CANNOT_TELL:
            judging |= dict.fromkeys(_to_judge(design, finding, tolerance))
    total = (ledger.spent + ledger.cost(judging)) / CONTRIBUTIONS_SHARE if judging else 0.0
    if outcome.pruned == design.full and len(outcome.proposals) > 1:
        # a proposal may take half of what is left, unless no other comes behind it
        left = _to_confirm(design, ledger, outcome, tolerance) * (
            2 if len(outcome.proposals) > 2 else 1
        )
        if left:
            total = max(total, left / (1 - CONTRIBUTIONS_SHARE) if judging else ledger.spent + left)
    return GRAIN * math.ceil(max(total, LEAST_GROWTH * budget) / GRAIN) if total else None


def _to_judge(design: Design, finding: Finding, tolerance: float) -> list[Trial]:
    """What a longer study would train for a finding: with more time trainings become longer before there are more."""
    sets = (finding.comparison.having, finding.comparison.lacking)
    if finding.gain.count < 2:
        return _trials(design, sets, design.first_look, finding.steps)
    cells = cells_to_judge(finding, tolerance)
    if cells is None:
        return []
    climb = [steps for steps in design.ladder[:-1] if steps > finding.steps]
    trials = [trial for steps in climb for trial in _trials(design, sets, design.first_look, steps)]
    return trials + _trials(design, sets, cells, design.ladder[-1])


def _to_confirm(design: Design, ledger: Ledger, outcome: Outcome, tolerance: float) -> float:
    open_ = [c for c in outcome.confirmations if c.passed is None]
    if not outcome.confirmations:
        sets = (design.full, outcome.proposals[0])
        return ledger.cost(_trials(design, sets, design.first_look, design.ladder[-1]))
    needed = [(c, cells) for c in open_ if (cells := cells_to_confirm(c, tolerance)) is not None]
    costs = [
        ledger.cost(
            _trials(design, (design.full, confirmation.regularizers), cells, design.ladder[-1])
        )
        for confirmation, cells in needed
    ]
    return min(costs, default=0.0)


def _trials(design: Design, sets: tuple[Selection, ...], cells: int, steps: int) -> list[Trial]:
    return [Trial(names, cell, steps) for cell in design.cells(cells) for names in sets]
