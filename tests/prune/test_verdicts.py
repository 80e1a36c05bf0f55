from __future__ import annotations

import math

import pytest

from nerfreg.analysis.statistics import Interval
from nerfreg.prune.plan import Comparison, Context, Design
from nerfreg.prune.verdicts import Finding, Verdict, judge, proposals

HELPS, HURTS, NOTHING, UNKNOWN = (0.5, 1.0), (-1.0, -0.5), (-0.05, 0.05), (-0.5, 0.5)
SLOWER, FASTER = (0.1, 0.2), (-0.2, -0.1)


def between(low: float, high: float) -> Interval:
    return Interval((low + high) / 2, low, high, 6, 0.1)


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (0.2, 0.9, Verdict.HELPS),
        (0.02, 0.9, Verdict.HELPS),
        (0.02, 0.09, Verdict.NO_DIFFERENCE),  # certain, and too little to matter
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


def findings(
    design: Design, **contributions: tuple[tuple[float, float], tuple[float, float], float]
) -> dict:
    """By name: the ends of its gain in the set and of its time, and its mean gain alone."""
    found = {}
    for comparison in (*design.comparisons(Context.SET), *design.comparisons(Context.ALONE)):
        gain, time, alone = contributions[comparison.regularizer]
        ends = between(*gain) if comparison.context is Context.SET else between(alone, alone)
        found[comparison] = Finding(comparison, 10, 0.01, ends, between(*time), judge(ends, 0.1))
    return found


def test_proposals_put_back_the_unknown_then_the_useless_then_what_hurts() -> None:
    design = Design(tuple("abcdef"), ((0,), (1,)), (10,))
    found = findings(
        design,
        a=(HELPS, SLOWER, 1.0),
        b=(HURTS, SLOWER, -1.0),
        c=(NOTHING, SLOWER, 0.1),
        d=(NOTHING, SLOWER, 0.8),
        e=(UNKNOWN, SLOWER, 0.0),
        f=(UNKNOWN, SLOWER, 0.0),
    )
    assert proposals(design, found) == (
        ("a",),
        tuple("aef"),
        tuple("adef"),
        tuple("acdef"),
        tuple("abcdef"),
    )


def test_what_saves_time_stays_unless_it_hurts() -> None:
    design = Design(tuple("abc"), ((0,), (1,)), (10,))
    found = findings(
        design, a=(NOTHING, FASTER, 0.0), b=(HURTS, FASTER, 0.0), c=(NOTHING, SLOWER, 0.0)
    )
    assert proposals(design, found) == (("a",), ("a", "c"), ("a", "b", "c"))


def test_nothing_to_propose_where_everything_helps() -> None:
    design = Design(tuple("ab"), ((0,), (1,)), (10,))
    assert proposals(design, findings(design, a=(HELPS, SLOWER, 1.0), b=(HELPS, SLOWER, 1.0))) == (
        ("a", "b"),
    )


def test_sentences() -> None:
    def sentence(gain: Interval) -> str:
        comparison = Comparison("a", Context.SET, ("a",), ())
        return Finding(comparison, 10, 0.01, gain, gain, judge(gain, 0.1)).sentence(0.1)

    assert sentence(between(0.2, 0.9)) == "helps by 0.20 to 0.90 dB"
    assert sentence(between(-0.9, -0.2)) == "hurts by 0.20 to 0.90 dB"
    assert sentence(between(-0.05, 0.02)) == "makes no difference beyond 0.1 dB (-0.05 to +0.02 dB)"
    assert sentence(between(-0.5, 0.2)) == "cannot tell (-0.50 to +0.20 dB)"
    assert sentence(Interval(0.3, -math.inf, math.inf, 1, math.nan)) == "cannot tell"
