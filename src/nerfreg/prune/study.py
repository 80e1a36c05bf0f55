"""The study: contributions by trainings of increasing length, then a smaller set confirmed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field

from nerfreg.analysis.statistics import error_of_look
from nerfreg.prune.ledger import Difference, Ledger, Verdict
from nerfreg.prune.plan import Context, Design, Pair, Selection, Stage

CONTRIBUTIONS_SHARE = 2 / 3
"""Of the budget; the rest is for confirming."""


@dataclass
class Study:
    """Measures, judges and decides within a budget.

    Attributes:
        design: What trials are chosen from.
        ledger: Measures them.
        budget: Seconds of all trials together.
        tolerance: dB of PSNR that count as no difference.
        say: Takes a line about each trial before it is measured.
        findings: What each regularizer adds, as it stands after the last look at it.
        proposals: The smaller sets to try, in order, and the full one behind them.
        confirmations: Those that were compared with the full set, by whole runs.
        pruned: The one that was confirmed, or the full set.
    """

    design: Design
    ledger: Ledger
    budget: float
    tolerance: float
    say: Callable[[str], None]
    findings: dict[Context, dict[str, Difference]] = field(init=False)
    proposals: tuple[Selection, ...] = field(init=False, default=())
    confirmations: dict[Selection, Difference] = field(init=False, default_factory=dict)
    pruned: Selection = field(init=False)

    def __post_init__(self) -> None:
        self.findings = {context: {} for context in Context}
        self.pruned = self.design.full
        self._first = self._stage = Stage(self.design.ladder[0], self.design.first_look)
        self._looks = self._confirming_looks = 0

    @property
    def dropped(self) -> list[str]:
        """Regularizers of the full set that the pruned one lacks."""
        return [name for name in self.design.full if name not in self.pruned]

    def run(self) -> None:
        """Find contributions, propose smaller sets, and confirm one of them."""
        self._contribute(CONTRIBUTIONS_SHARE * self.budget)
        self._decide()
        if not self.confirmations and len(self.proposals) > 1:
            # There is no time to confirm anything, but perhaps to know more of the contributions.
            self._contribute(self.budget)
            self._decide()

    def _contribute(self, until: float) -> None:
        """Compare everything at the first stage, then what is undecided at further ones.

        Adding to vanilla is measured at the first stage only: no verdict depends on it. Called
        again with more time, this goes on with the stage at which it stopped.
        """
        while pairs := self._undecided(Context if self._stage == self._first else [Context.SET]):
            self._looks += 1
            error = error_of_look(self._looks, len(self.design.full))
            found = self._compare(pairs.values(), self._stage, error, until)
            for (context, name), new in zip(pairs, found, strict=True):
                old = self.findings[context].get(name, new)
                self.findings[context][name] = max(old, new, key=self._rank)
            left = self._undecided([Context.SET]).values()
            following = self._following(left, self._stage, until)
            if not left or following is None:
                return
            self._stage = following

    def _undecided(self, contexts: Iterable[Context]) -> dict[tuple[Context, str], Pair]:
        return {
            (context, name): self.design.pair(name, context)
            for context in contexts
            for name in self.design.full
            if not (found := self.findings[context].get(name))
            or found.verdict(self.tolerance) is Verdict.CANNOT_TELL
        }

    def _rank(self, found: Difference) -> tuple[bool, int, float]:
        """Rank a finding: one that decides, else of longer trainings, else a narrower interval."""
        decided = found.verdict(self.tolerance) is not Verdict.CANNOT_TELL
        return decided, found.steps * (found.gain.count > 1), found.gain.low - found.gain.high

    def _decide(self) -> None:
        """Confirm the first proposal that is no worse than the full set."""
        in_set, alone = self.findings[Context.SET], self.findings[Context.ALONE]
        self.proposals = proposals(self.design.full, in_set, alone, self.tolerance)
        for proposal in self.proposals[:-1]:
            left = self.budget - self.ledger.spent
            share = left if proposal == self.proposals[-2] else left / 2
            found = self._confirm(proposal, self.ledger.spent + share)
            if found is not None:
                self.confirmations[proposal] = found
                if found.no_worse(self.tolerance):
                    self.pruned = proposal
                    return

    def _confirm(self, proposal: Selection, until: float) -> Difference | None:
        """Compare a smaller set with the full one until it is clear whether it is worse.

        By whole runs, since many a regularizer hurts a short training and pays off in a long one;
        None if there is no time for them.
        """
        pairs = [(proposal, self.design.full)]
        whole = Stage(self.design.ladder[-1], self.design.first_look)
        stage = whole if self._fits(pairs, whole, until) else None
        found = None
        while stage is not None and (found is None or found.no_worse(self.tolerance) is None):
            self._confirming_looks += 1
            error = error_of_look(self._confirming_looks, 1)
            [found] = self._compare(pairs, stage, error, until)
            stage = self._following(pairs, stage, until)
        return found

    def _compare(
        self, pairs: Collection[Pair], stage: Stage, error: float, until: float
    ) -> list[Difference]:
        """Measure the trials of a stage while there is time, then compare what there is."""
        cells = self.design.cells(stage.cells)
        for trial in self.design.trials(pairs, stage):
            if trial in self.ledger.trials:
                continue
            if self.ledger.spent + self.ledger.cost([trial]) > until:
                break
            held_out = ",".join(map(str, trial.held_out))
            position = cells.index((trial.held_out, trial.seed)) + 1
            self.say(
                f"{self.ledger.spent:5.0f} of {self.budget:.0f} s: "
                f"{self.design.label(trial.regularizers)}, {trial.steps} steps, view {held_out} "
                f"held out, seed {trial.seed} (cell {position} of {stage.cells})"
            )
            self.ledger.add(trial)
        return [self.ledger.difference(*pair, cells, stage.steps, error) for pair in pairs]

    def _following(self, pairs: Collection[Pair], stage: Stage, until: float) -> Stage | None:
        """Return the first of these that fits: longer trainings, up to twice the cells, nothing."""
        longer = [steps for steps in self.design.ladder if steps > stage.steps]
        more = range(stage.cells, 0, -len(self.design.folds))
        stages = [Stage(steps, self.design.first_look) for steps in longer[:1]]
        stages += [Stage(stage.steps, stage.cells + cells) for cells in more]
        return next((larger for larger in stages if self._fits(pairs, larger, until)), None)

    def _fits(self, pairs: Collection[Pair], stage: Stage, until: float) -> bool:
        return self.ledger.spent + self.ledger.cost(self.design.trials(pairs, stage)) <= until


def proposals(
    full: Selection,
    in_set: Mapping[str, Difference],
    alone: Mapping[str, Difference],
    tolerance: float,
) -> tuple[Selection, ...]:
    """Return the sets to compare with the full one, in the order of trial; it stands last itself.

    The first has what helps, and what saves time without hurting. What cannot be told is then put
    back all at once; what makes no difference one by one, the best alone first, because two
    regularizers that can replace each other both seem useless; and what hurts comes last.
    """
    verdicts = {name: found.verdict(tolerance) for name, found in in_set.items()}

    def those(verdict: Verdict) -> list[str]:
        return [name for name, own in verdicts.items() if own is verdict]

    def gain_alone(name: str) -> float:
        return alone[name].gain.mean if alone[name].gain.count else 0.0

    saving = {name for name, found in in_set.items() if found.time.high < 0}
    kept = {*those(Verdict.HELPS), *saving.difference(those(Verdict.HURTS))}
    chain = [kept]
    spare = sorted(those(Verdict.NO_DIFFERENCE), key=gain_alone, reverse=True)
    for returned in (those(Verdict.CANNOT_TELL), *([name] for name in spare), full):
        kept = kept.union(returned)
        chain.append(kept)
    return tuple(dict.fromkeys(tuple(name for name in full if name in kept) for kept in chain))
