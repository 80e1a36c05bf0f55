from __future__ import annotations

import math

import pytest

from nerfreg.analysis.statistics import Interval
from nerfreg.prune.ledger import Difference
from nerfreg.prune.report import finding_sentence
from nerfreg.prune.verdicts import Verdict, judge, no_worse, proposals

HELPS, HURTS, NOTHING, UNKNOWN = (0.5, 1.0), (-1.0, -0.5), (-0.05, 0.05), (-0.5, 0.5)
SLOWER, FASTER = (0.1, 0.2), (-0.2, -0.1)


def between(low: float, high: float) -> Interval:
    return Interval((low + high) / 2, low, high, 6, 0.1)


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (0.2, 0.9, Verdict.HELPS),
        (0.02, 0.9, Verdict.HELPS),
        (0.02, 0.09, Verdict.NO_DIFFERENCE),  # It is certain, and too little to matter.
        (-0.1, 0.1, Verdict.NO_DIFFERENCE),
        (-0.1, 0.11, Verdict.CANNOT_TELL),
        (0.0, 0.5, Verdict.CANNOT_TELL),
        (-0.5, -0.01, Verdict.HURTS),
        (-0.09, -0.01, Verdict.NO_DIFFERENCE),
        (-math.inf, math.inf, Verdict.CANNOT_TELL),
    ],
)
def test_judge(low: float, high: float, verdict: Verdict) -> None:
    assert judge(between(low, high), 0.1) is verdict


@pytest.mark.parametrize(
    ("low", "high", "passed"),
    [
        (-0.1, 0.5, True),
        (0.2, 0.5, True),
        (-0.5, -0.11, False),
        (-0.5, -0.1, None),
        (-0.11, 0.5, None),
        (-math.inf, math.inf, None),
    ],
)
def test_no_worse(low: float, high: float, passed: bool | None) -> None:
    assert no_worse(between(low, high), 0.1) is passed


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


def test_sentences() -> None:
    def sentence(gain: Interval) -> str:
        return finding_sentence(Difference(10, 0.01, gain, gain), 0.1)

    assert sentence(between(0.2, 0.9)) == "helps by 0.20 to 0.90 dB"
    assert sentence(between(-0.9, -0.2)) == "hurts by 0.20 to 0.90 dB"
    assert sentence(between(-0.05, 0.02)) == "makes no difference beyond 0.1 dB (-0.05 to +0.02 dB)"
    assert sentence(between(-0.5, 0.2)).startswith("cannot tell (-0.50 to +0.20 dB); ")
    assert sentence(Interval(0.3, -math.inf, math.inf, 1, math.nan)) == "cannot tell: too few cells"
