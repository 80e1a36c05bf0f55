"""The decisions, driven by trainings whose outcome is made up."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from nerfreg.analysis.statistics import Interval
from nerfreg.prune.advice import budget_needed
from nerfreg.prune.ledger import Difference, Ledger, Measurement, Verdict
from nerfreg.prune.plan import Context, Design, Selection, Trial, make_folds, make_ladder
from nerfreg.prune.study import Study, proposals

TOLERANCE = 0.1
Gain = Callable[[Selection], float]


def made_up(gain: Gain, noise: float, salt: int = 0) -> Callable[[Trial], Measurement]:
    """Add the gain of a set, the level of a cell, which all sets share, and noise of each trial.

    A step takes 10 ms, and 1 ms more for each regularizer; a trial takes as long as its steps.
    """

    def measure(trial: Trial) -> Measurement:
        cell = f"{salt} {trial.held_out} {trial.seed}"
        level = random.Random(cell).gauss(20, 2)
        own = random.Random(f"{cell} {trial.regularizers} {trial.steps}").gauss(0, noise)
        step_seconds = 0.01 + 0.001 * len(trial.regularizers)
        return Measurement(
            level + gain(trial.regularizers) + own, None, step_seconds, step_seconds * trial.steps
        )

    return measure


def studied(names: str, measure: Callable[[Trial], Measurement], budget: float) -> Study:
    """Three views, runs of 400 steps, of 4 seconds and more each."""
    design = Design(tuple(names), make_folds(3, None), make_ladder(None, 400))
    study = Study(design, Ledger(measure), budget, TOLERANCE, lambda line: None)
    study.run()
    return study


def additive(**gains: float) -> Gain:
    return lambda names: sum(gains[name] for name in names)


def verdicts(study: Study, context: Context = Context.SET) -> dict[str, Verdict]:
    return {name: found.verdict(TOLERANCE) for name, found in study.findings[context].items()}


@pytest.fixture(scope="module")
def clear() -> Study:
    """Let a help by 1 dB, b do nothing, c hurt by 1 dB; differences deviate by 0.3 dB."""
    return studied("abc", made_up(additive(a=1.0, b=0.0, c=-1.0), 0.3 / 2**0.5), 6000.0)


def test_what_helps_stays_and_what_hurts_goes(clear: Study) -> None:
    found = verdicts(clear)
    assert (found["a"], found["c"]) == (Verdict.HELPS, Verdict.HURTS)
    assert found["b"] not in (Verdict.HELPS, Verdict.HURTS)
    assert clear.pruned == ("a",)
    assert clear.confirmations["a",].gain.low > 0.5


def test_true_contributions_lie_in_the_intervals(clear: Study) -> None:
    truth = {"a": 1.0, "b": 0.0, "c": -1.0}
    # In the set: 13 ms a step against 12; alone: 11 against 10.
    shares = {Context.SET: 1 / 12, Context.ALONE: 1 / 10}
    for context, findings in clear.findings.items():
        for name, found in findings.items():
            assert found.gain.low <= truth[name] <= found.gain.high
            assert found.time.mean == pytest.approx(shares[context])


def test_only_what_is_undecided_is_trained_for_longer(clear: Study) -> None:
    longest = {name: found.steps for name, found in clear.findings[Context.SET].items()}
    assert longest["a"] == longest["c"] == 100 and longest["b"] == 400
    sets = {trial.regularizers for trial in clear.ledger.trials if trial.steps == 200}
    assert sets == {tuple("abc"), tuple("ac")}
    assert any(trial.steps == 100 and trial.regularizers == ("b",) for trial in clear.ledger.trials)


def test_cells_are_measured_over_all_sets_before_the_next(clear: Study) -> None:
    trials = [trial for trial in clear.ledger.trials if trial.steps == 100]
    # 3 regularizers: the full set, vanilla, 3 without one, 3 alone; 6 cells.
    assert len(trials) == 8 * 6
    rounds = [trials[8 * i : 8 * (i + 1)] for i in range(6)]
    assert all(len({(trial.held_out, trial.seed) for trial in one}) == 1 for one in rounds)
    assert len({one[0].regularizers for one in rounds}) == 6  # Another set begins each.


@pytest.mark.parametrize("budget", [0.1, 10.0, 40.0, 300.0])
def test_the_budget_is_kept(budget: float) -> None:
    study = studied("abc", made_up(additive(a=0.2, b=0.0, c=0.0), 0.5), budget)
    # The first trial is measured without knowing what one costs: 1.3 s.
    assert study.ledger.spent <= max(budget, 1.3)
    assert set(study.pruned) <= set("abc")


def test_too_little_time_is_no_reason_to_drop_anything() -> None:
    study = studied("abc", made_up(additive(a=1.0, b=0.0, c=-1.0), 0.2), 10.0)
    assert set(verdicts(study).values()) == {Verdict.CANNOT_TELL}
    assert study.pruned == ("a", "b", "c") and not study.confirmations
    needed = budget_needed(study)
    assert needed is not None and needed > 10


def test_the_budget_that_is_asked_for_is_right_within_a_factor_of_two() -> None:
    # Mostly: it is a guess from a few differences.
    undecided = enough = 0
    for salt in range(10):
        measure = made_up(additive(a=0.5, b=-0.5), 0.35, salt)
        study = studied("ab", measure, 120.0)
        if Verdict.CANNOT_TELL in verdicts(study).values():
            needed = budget_needed(study)
            assert needed is not None and needed > 120
            undecided += 1
            again = verdicts(studied("ab", measure, 2.0 * needed))
            enough += again == {"a": Verdict.HELPS, "b": Verdict.HURTS}
    assert undecided >= 4 and enough >= 0.8 * undecided


def test_one_of_two_that_replace_each_other_goes() -> None:
    # Leaving out either of a and b changes nothing, leaving out both costs 1 dB; a alone seems
    # better than b alone.
    def gain(names: Selection) -> float:
        return 1.0 if "a" in names else 0.95 if "b" in names else 0.0

    study = studied("ab", made_up(gain, 0.005), 6000.0)
    assert verdicts(study)["b"] is Verdict.NO_DIFFERENCE
    passed = {names: found.no_worse(TOLERANCE) for names, found in study.confirmations.items()}
    assert passed == {(): False, ("a",): True}
    assert study.pruned == ("a",)


@pytest.mark.parametrize("budget", [40.0, 60.0, 100.0, 6000.0])
@pytest.mark.parametrize("pays_from", [200, 400])
def test_what_hurts_a_short_training_and_pays_in_a_long_one_is_not_dropped(
    pays_from: int, budget: float
) -> None:
    whole = made_up(additive(a=0.0), 0.05)

    def measure(trial: Trial) -> Measurement:
        measured = whole(trial)
        assert measured.psnr is not None
        late = 1.0 if trial.steps >= pays_from else -1.0
        return Measurement(
            measured.psnr + late * len(trial.regularizers), None, 0.01, measured.seconds
        )

    study = studied("a", measure, budget)
    assert verdicts(study) == {"a": Verdict.HURTS}
    # 2 sets, 6 cells, 4 s or 4.4 s each: 50 s, which the first stage does not leave of 60 s.
    passed = [found.no_worse(TOLERANCE) for found in study.confirmations.values()]
    assert passed == ([False] if budget >= 100 else [])
    assert study.pruned == ("a",)


def test_identical_trainings_make_no_difference() -> None:
    # No noise at all: every interval is a point.
    study = studied("ab", made_up(additive(a=0.0, b=0.0), 0.0), 600.0)
    assert set(verdicts(study).values()) == {Verdict.NO_DIFFERENCE}
    assert study.pruned == ()


def test_a_set_that_cannot_be_trained_is_not_judged() -> None:
    plain = made_up(additive(a=1.0, b=0.0), 0.1)

    def measure(trial: Trial) -> Measurement:
        if trial.regularizers == ("b",):
            return Measurement(None, None, 0.01, 0.5, "not finite")
        return plain(trial)

    study = studied("ab", measure, 400.0)
    assert verdicts(study)["a"] is Verdict.CANNOT_TELL
    assert study.findings[Context.SET]["a"].gain.count == 0
    assert verdicts(study, Context.ALONE)["a"] is Verdict.HELPS


def test_false_verdicts_are_rare_in_spite_of_many_looks() -> None:
    # Neither does anything. Every look at every one could go wrong; together at most 1 study in
    # 20 may: 2 of 40, and 7 or more once in 200 times (Poisson).
    wrong = 0
    for salt in range(40):
        study = studied("ab", made_up(additive(a=0.0, b=0.0), 0.3, salt), 200.0)
        wrong += any(
            verdict in (Verdict.HELPS, Verdict.HURTS) for verdict in verdicts(study).values()
        )
    assert wrong <= 6


def test_a_set_that_is_worse_is_rarely_confirmed() -> None:
    # Without a the set is 0.4 dB worse, four times what is tolerated; at most 1.5 of 30 by chance.
    dropped = 0
    for salt in range(30):
        dropped += (
            "a" not in studied("ab", made_up(additive(a=0.4, b=0.0), 0.3, salt), 200.0).pruned
        )
    assert dropped <= 5


def test_one_regularizer_is_compared_once() -> None:
    study = studied("a", made_up(additive(a=1.0), 0.1), 600.0)
    assert {trial.regularizers for trial in study.ledger.trials} == {("a",), ()}
    in_set, alone = study.findings[Context.SET], study.findings[Context.ALONE]
    assert in_set["a"].gain == alone["a"].gain
    assert study.proposals == (("a",),) and study.pruned == ("a",)


def test_time_that_is_left_where_nothing_can_be_confirmed_goes_into_contributions() -> None:
    # 8 sets, 6 cells, 1.15 s each: 55 s. Two thirds of 60 s do not complete the first stage; the
    # rest is less than 6 cells of a whole run for two sets take, 62 s, and completes it.
    study = studied("abc", made_up(additive(a=0.1, b=0.1, c=0.1), 0.3), 60.0)
    assert not study.confirmations
    assert 40 < study.ledger.spent <= 60
    assert {(t.held_out, t.seed) for t in study.ledger.trials} == set(study.design.cells(6))


HELPS, HURTS, NOTHING, UNKNOWN = (0.5, 1.0), (-1.0, -0.5), (-0.05, 0.05), (-0.5, 0.5)
SLOWER, FASTER = (0.1, 0.2), (-0.2, -0.1)


def between(low: float, high: float) -> Interval:
    return Interval((low + high) / 2, low, high, 6, 0.1)


def proposed(
    **contributions: tuple[tuple[float, float], tuple[float, float], float],
) -> tuple[str, ...]:
    """Give by name the ends of its gain in the set and of its time, and its mean gain alone.

    Returns:
        The names in each proposal.
    """
    in_set, alone = {}, {}
    for name, (gain, time, mean) in contributions.items():
        in_set[name] = Difference(10, 0.01, between(*gain), between(*time))
        alone[name] = Difference(10, 0.01, between(mean, mean), between(*time))
    return tuple("".join(names) for names in proposals(tuple(contributions), in_set, alone, 0.1))


def test_proposals_put_back_the_unknown_then_the_useless_then_what_hurts() -> None:
    found = proposed(
        a=(HELPS, SLOWER, 1.0),
        b=(HURTS, SLOWER, -1.0),
        c=(NOTHING, SLOWER, 0.1),
        d=(NOTHING, SLOWER, 0.8),
        e=(UNKNOWN, SLOWER, 0.0),
        f=(UNKNOWN, SLOWER, 0.0),
    )
    assert found == ("a", "aef", "adef", "acdef", "abcdef")


def test_what_saves_time_stays_unless_it_hurts() -> None:
    found = proposed(a=(NOTHING, FASTER, 0.0), b=(HURTS, FASTER, 0.0), c=(NOTHING, SLOWER, 0.0))
    assert found == ("a", "ac", "abc")


def test_nothing_to_propose_where_everything_helps() -> None:
    assert proposed(a=(HELPS, SLOWER, 1.0), b=(HELPS, SLOWER, 1.0)) == ("ab",)
