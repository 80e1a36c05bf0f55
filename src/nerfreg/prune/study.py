"""The study: contributions by trainings of increasing length, then the smaller set confirmed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from nerfreg.analysis.statistics import error_of_look
from nerfreg.prune.ledger import Difference, Ledger
from nerfreg.prune.plan import Context, Design, Selection, Stage
from nerfreg.prune.verdicts import Verdict, judge, no_worse, proposals

CONTRIBUTIONS_SHARE = 2 / 3
"""Of the budget; the rest is for confirming."""


@dataclass(frozen=True)
class StudyResult:
    """What a study found.

    Attributes:
        findings: What each regularizer adds, as it stands after the last look at it.
        proposals: The smaller sets to try, in order, and the full one behind them.
        confirmations: Those that were compared with the full set, by whole runs.
        pruned: The one that was confirmed, or the full set.
    """

    findings: dict[Context, dict[str, Difference]]
    proposals: tuple[Selection, ...]
    confirmations: dict[Selection, Difference]
    pruned: Selection


class Study:
    """Measures, judges and decides within a budget."""

    def __init__(
        self,
        design: Design,
        ledger: Ledger,
        budget: float,
        tolerance: float,
        say: Callable[[str], None],
    ) -> None:
        """Prepare a study.

        Args:
            design: What to choose trials from.
            ledger: Measures them.
            budget: Seconds of all trials together.
            tolerance: dB of PSNR that count as no difference.
            say: Takes a line about each trial before it is measured.
        """
        self.design = design
        self.ledger = ledger
        self.budget = budget
        self.tolerance = tolerance
        self._say = say
        self._first_stage = self._stage = Stage(design.ladder[0], design.first_look)
        self._findings: dict[Context, dict[str, Difference]] = {c: {} for c in Context}
        self._looks = self._confirming_looks = 0

    def run(self) -> StudyResult:
        """Find contributions, propose smaller sets, and confirm one of them."""
        self._contribute(CONTRIBUTIONS_SHARE * self.budget)
        result = self._decide()
        if result.confirmations or len(result.proposals) == 1:
            return result
        # There is no time to confirm anything, but perhaps to know more of the contributions.
        self._contribute(self.budget)
        return self._decide()

    def _contribute(self, until: float) -> None:
        """Compare everything at the first stage, then what is undecided at further ones.

        Adding to vanilla is measured at the first stage only: no verdict depends on it. Called
        again with more time, this goes on with the stage at which it stopped.
        """
        while undecided := self._undecided(
            *(Context if self._stage == self._first_stage else (Context.SET,))
        ):
            self._measure(self._sets(undecided), self._stage, until)
            self._looks += 1
            error = error_of_look(self._looks, len(self.design.full))
            for context, name in undecided:
                new = self._difference(*self.design.pair(name, context), self._stage, error)
                known = self._findings[context]
                known[name] = self._better(known.get(name), new)
            undecided = self._undecided(Context.SET)
            following = self._following(self._stage, self._sets(undecided), until)
            if not undecided or following is None:
                return
            self._stage = following

    def _decide(self) -> StudyResult:
        """Confirm the first proposal that is no worse than the full set."""
        in_set, alone = self._findings[Context.SET], self._findings[Context.ALONE]
        chain = proposals(self.design.full, in_set, alone, self.tolerance)
        confirmations: dict[Selection, Difference] = {}
        for proposal in chain[:-1]:
            left = self.budget - self.ledger.spent
            share = left if proposal == chain[-2] else left / 2
            found = self._confirm(proposal, self.ledger.spent + share)
            if found is not None:
                confirmations[proposal] = found
                if no_worse(found.gain, self.tolerance):
                    return StudyResult(self._findings, chain, confirmations, proposal)
        return StudyResult(self._findings, chain, confirmations, self.design.full)

    def _confirm(self, proposal: Selection, until: float) -> Difference | None:
        """Compare a smaller set with the full one until it is clear whether it is worse.

        By whole runs, since many a regularizer hurts a short training and pays off in a long one;
        None if there is no time for them.
        """
        sets = (self.design.full, proposal)
        stage: Stage | None = Stage(self.design.ladder[-1], self.design.first_look)
        found = None
        if not self._fits(sets, stage, until):
            return None
        while stage is not None:
            self._measure(sets, stage, until)
            self._confirming_looks += 1
            error = error_of_look(self._confirming_looks, 1)
            found = self._difference(proposal, self.design.full, stage, error)
            if no_worse(found.gain, self.tolerance) is not None:
                break
            stage = self._following(stage, sets, until)
        return found

    def _undecided(self, *contexts: Context) -> list[tuple[Context, str]]:
        return [
            (context, name)
            for context in contexts
            for name in self.design.full
            if (found := self._findings[context].get(name)) is None or not self._decides(found)
        ]

    def _decides(self, found: Difference) -> bool:
        return judge(found.gain, self.tolerance) is not Verdict.CANNOT_TELL

    def _better(self, old: Difference | None, new: Difference) -> Difference:
        """Choose what decides, else longer trainings, else the narrower interval."""
        if old is None or self._decides(new):
            return new
        if new.gain.count < min(old.gain.count, 2):
            return old
        if new.steps > old.steps and new.gain.count >= 2:
            return new
        return new if new.gain.high - new.gain.low < old.gain.high - old.gain.low else old

    def _difference(
        self, first: Selection, second: Selection, stage: Stage, error: float
    ) -> Difference:
        return self.ledger.difference(
            first, second, self.design.cells(stage.cells), stage.steps, error
        )

    def _sets(self, undecided: Sequence[tuple[Context, str]]) -> tuple[Selection, ...]:
        """Return the full set and vanilla first, then the others, each once."""
        pairs = (self.design.pair(name, context) for context, name in undecided)
        sets = {names: None for pair in pairs for names in pair}
        return tuple(sorted(sets, key=lambda names: names not in (self.design.full, ())))

    def _measure(self, sets: Sequence[Selection], stage: Stage, until: float) -> None:
        """Measure the trials of a stage as long as there is time."""
        for position, trial in enumerate(self.design.trials(sets, stage)):
            if trial in self.ledger.trials:
                continue
            if self.ledger.spent + self.ledger.cost([trial]) > until:
                return
            held_out = ",".join(map(str, trial.held_out))
            self._say(
                f"{self.ledger.spent:5.0f} of {self.budget:.0f} s: "
                f"{self.design.label(trial.regularizers)}, {trial.steps} steps, "
                f"view {held_out} held out, seed {trial.seed} "
                f"(cell {position // len(sets) + 1} of {stage.cells})"
            )
            self.ledger.add(trial)

    def _following(self, stage: Stage, sets: Sequence[Selection], until: float) -> Stage | None:
        """Return the first of these that fits: longer trainings, up to twice the cells, nothing."""
        longer = [steps for steps in self.design.ladder if steps > stage.steps]
        more = range(stage.cells, 0, -len(self.design.folds))
        stages = [Stage(steps, self.design.first_look) for steps in longer[:1]]
        stages += [Stage(stage.steps, stage.cells + cells) for cells in more]
        return next((larger for larger in stages if self._fits(sets, larger, until)), None)

    def _fits(self, sets: Sequence[Selection], stage: Stage, until: float) -> bool:
        return self.ledger.spent + self.ledger.cost(self.design.trials(sets, stage)) <= until
