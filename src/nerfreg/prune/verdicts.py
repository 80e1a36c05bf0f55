"""What intervals mean: a verdict on each regularizer, and the smaller sets to try."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from nerfreg.analysis.statistics import Interval
from nerfreg.prune.ledger import Difference
from nerfreg.prune.plan import Selection


class Verdict(StrEnum):
    """What can be said of a regularizer's contribution."""

    HELPS = "helps"
    HURTS = "hurts"
    NO_DIFFERENCE = "no difference"
    CANNOT_TELL = "cannot tell"


def judge(gain: Interval, tolerance: float) -> Verdict:
    """Return the verdict on a gain, both in dB; a certain gain within the tolerance is none."""
    if gain.inside(tolerance):
        return Verdict.NO_DIFFERENCE
    if gain.low > 0:
        return Verdict.HELPS
    return Verdict.HURTS if gain.high < 0 else Verdict.CANNOT_TELL


def no_worse(gain: Interval, tolerance: float) -> bool | None:
    """Return whether a set that gains this, in dB, may replace the other; None: cannot tell."""
    if gain.low >= -tolerance:
        return True
    return False if gain.high < -tolerance else None


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

    Args:
        full: The full set.
        in_set: What each regularizer adds to the rest of the full set.
        alone: What each adds to vanilla.
        tolerance: dB of PSNR that count as no difference.
    """
    verdicts = {name: judge(found.gain, tolerance) for name, found in in_set.items()}

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
