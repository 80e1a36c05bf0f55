"""The study itself: contributions by successive halving over numbers of steps, then the smaller set confirmed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from nerfreg.analysis.statistics import Interval, error_of_look, interval
from nerfreg.prune.ledger import Ledger
from nerfreg.prune.plan import Cell, Comparison, Context, Design, Selection, Trial
from nerfreg.prune.verdicts import Finding, Verdict, judge, proposals

CONTRIBUTIONS_SHARE = 2 / 3
"""Of the time budget; the rest is for confirming."""


@dataclass(frozen=True)
class Stage:
    """So many cells of trainings of so many steps."""

    steps: int
    cells: int


@dataclass(frozen=True)
class Confirmation:
    """A proposed set against the full one, by whole runs.

    gain: dB that it has over the full set. time: what a step takes longer, as a share. passed: None: cannot tell.
    error: the chance that the intervals were allowed to miss.
    """

    regularizers: Selection
    error: float
    gain: Interval
    time: Interval
    passed: bool | None


@dataclass(frozen=True)
class Outcome:
    """findings: of every comparison. proposals: the smaller sets to try, the full set behind them.
    confirmations: of as many of them as there was time for. pruned: the one that passed, or the full set."""

    findings: dict[Comparison, Finding]
    proposals: tuple[Selection, ...]
    confirmations: tuple[Confirmation, ...]
    pruned: Selection

    @property
    def contributions(self) -> list[Finding]:
        """Of each regularizer in the full set; these decide."""
        return [
            finding
            for finding in self.findings.values()
            if finding.comparison.context is Context.SET
        ]


class Study:
    """Measures, judges and decides, within a budget of seconds.

    say: takes a line about each trial before it is measured.
    """

    def __init__(
        self,
        design: Design,
        ledger: Ledger,
        budget: float,
        tolerance: float,
        say: Callable[[str], None],
    ) -> None:
        self.design = design
        self.ledger = ledger
        self.budget = budget
        self.tolerance = tolerance
        self._say = say
        self._first_stage = self._stage = Stage(design.ladder[0], design.first_look)
        self._findings: dict[Comparison, Finding] = {}
        self._looks = self._confirming_looks = 0

    def run(self) -> Outcome:
        """Contributions, proposals, confirmations."""
        outcome = self._decide(self.contributions(CONTRIBUTIONS_SHARE * self.budget))
        if outcome.confirmations or len(outcome.proposals) == 1:
            return outcome
        # There is no time to confirm anything, but perhaps to know more of the contributions.
        return self._decide(self.contributions(self.budget))

    def _decide(self, findings: dict[Comparison, Finding]) -> Outcome:
        """The first proposal that is confirmed, or the full set."""
        chain = proposals(self.design, findings)
        confirmations: list[Confirmation] = []
        for position, proposal in enumerate(chain[:-1]):
            left = self.budget - self.ledger.spent
            last = position == len(chain) - 2
            confirmation = self.confirm(proposal, self.ledger.spent + (left if last else left / 2))
            if confirmation is None:
                continue
            confirmations.append(confirmation)
            if confirmation.passed:
                return Outcome(findings, chain, tuple(confirmations), proposal)
        return Outcome(findings, chain, tuple(confirmations), self.design.full)

    def contributions(self, until: float) -> dict[Comparison, Finding]:
        """A finding for each comparison: all at the first stage, then those that are still undecided.

        Adding to vanilla is measured at the first stage only: the verdicts do not depend on it. Called again, with
        more time, it goes on with the stage at which it stopped.
        """
        in_set = self.design.comparisons(Context.SET)
        while undecided := self._undecided():
            self._measure(
                self._sets(undecided),
                self.design.cells(self._stage.cells),
                self._stage.steps,
                until,
            )
            self._looks += 1
            for comparison in undecided:
                finding = self._find(
                    comparison, self._stage, error_of_look(self._looks, len(in_set))
                )
                self._findings[comparison] = better(self._findings.get(comparison), finding)
            open_ = [c for c in in_set if self._findings[c].verdict is Verdict.CANNOT_TELL]
            following = self._following(self._stage, self._sets(open_), until)
            if not open_ or following is None:
                break
            self._stage = following
        return dict(self._findings)

    def _undecided(self) -> list[Comparison]:
        """What the present stage is for."""
        contexts = Context if self._stage == self._first_stage else (Context.SET,)
        comparisons = [c for context in contexts for c in self.design.comparisons(context)]
        known = self._findings
        return [c for c in comparisons if c not in known or known[c].verdict is Verdict.CANNOT_TELL]

    def confirm(self, proposal: Selection, until: float) -> Confirmation | None:
        """Compare a smaller set with the full one until it is clear that it is no worse, or that it is.

        By whole runs, since many a regularizer hurts a short training and pays in a long one; None where they do not
        fit into the time.
        """
        sets = (self.design.full, proposal)
        stage = Stage(self.design.ladder[-1], self.design.first_look)
        if not self._fits(sets, stage, until):
            return None
        while True:
            cells = self.design.cells(stage.cells)
            self._measure(sets, cells, stage.steps, until)
            self._confirming_looks += 1
            error = error_of_look(self._confirming_looks, 1)
            gain = interval(
                self.ledger.gains(proposal, self.design.full, cells, stage.steps), error
            )
            time = interval(
                self.ledger.extra_times(proposal, self.design.full, cells, stage.steps), error
            )
            passed = (
                True
                if gain.low >= -self.tolerance
                else False
                if gain.high < -self.tolerance
                else None
            )
            more = self._more_cells(stage, sets, until)
            if passed is not None or more is None:
                return Confirmation(proposal, error, gain, time, passed)
            stage = more

    def _find(self, comparison: Comparison, stage: Stage, error: float) -> Finding:
        cells, sets = self.design.cells(stage.cells), (comparison.having, comparison.lacking)
        gain = interval(self.ledger.gains(*sets, cells, stage.steps), error)
        time = interval(self.ledger.extra_times(*sets, cells, stage.steps), error)
        return Finding(comparison, stage.steps, error, gain, time, judge(gain, self.tolerance))

    def _sets(self, comparisons: Sequence[Comparison]) -> tuple[Selection, ...]:
        """The full set and vanilla first, then the others, each once."""
        sets = {s: None for c in comparisons for s in (c.having, c.lacking)}
        return tuple(sorted(sets, key=lambda s: s not in (self.design.full, ())))

    def _measure(
        self, sets: Sequence[Selection], cells: Sequence[Cell], steps: int, until: float
    ) -> None:
        """One cell over all sets, then the next, as long as there is time; another set begins each cell.

        So whatever else the machine does falls on all sets alike.
        """
        for position, cell in enumerate(cells):
            first = position % len(sets)
            for names in (*sets[first:], *sets[:first]):
                trial = Trial(names, cell, steps)
                if trial in self.ledger.trials:
                    continue
                if self.ledger.spent + self.ledger.cost([trial]) > until:
                    return
                held_out = ",".join(map(str, cell.held_out))
                self._say(
                    f"{self.ledger.spent:5.0f} of {self.budget:.0f} s: {self.design.label(names)}, {steps} steps, "
                    f"view {held_out} held out, seed {cell.seed} (cell {position + 1} of {len(cells)})"
                )
                self.ledger.add(trial)

    def _following(self, stage: Stage, sets: Sequence[Selection], until: float) -> Stage | None:
        """Longer trainings if there is time for them, else more cells of the same, else nothing."""
        higher = next((steps for steps in self.design.ladder if steps > stage.steps), None)
        if higher is not None:
            longer = Stage(higher, self.design.first_look)
            if self._fits(sets, longer, until):
                return longer
        return self._more_cells(stage, sets, until)

    def _more_cells(self, stage: Stage, sets: Sequence[Selection], until: float) -> Stage | None:
        """Up to twice the cells, in whole rounds over the folds."""
        rounds = stage.cells // len(self.design.folds)
        for more in range(rounds, 0, -1):
            larger = Stage(stage.steps, stage.cells + more * len(self.design.folds))
            if self._fits(sets, larger, until):
                return larger
        return None

    def _fits(self, sets: Sequence[Selection], stage: Stage, until: float) -> bool:
        trials = [
            Trial(names, cell, stage.steps)
            for cell in self.design.cells(stage.cells)
            for names in sets
        ]
        return self.ledger.spent + self.ledger.cost(trials) <= until


def better(old: Finding | None, new: Finding) -> Finding:
    """The finding that says more: one that decides, else the one of longer trainings, else the narrower one."""
    if old is None or new.verdict is not Verdict.CANNOT_TELL:
        return new
    if new.gain.count < min(old.gain.count, 2):
        return old
    if new.steps > old.steps and new.gain.count >= 2:
        return new
    return new if new.gain.high - new.gain.low < old.gain.high - old.gain.low else old
