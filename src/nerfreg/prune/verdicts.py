"""What intervals mean: verdicts on regularizers, and what to keep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from nerfreg.analysis.statistics import Interval
from nerfreg.prune.plan import Comparison, Context, Design, Selection


class Verdict(StrEnum):
    """What can be said of a regularizer's contribution."""

    HELPS = "helps"
    HURTS = "hurts"
    NO_DIFFERENCE = "no difference"
    CANNOT_TELL = "cannot tell"


@dataclass(frozen=True)
class Finding:
    """A comparison as it stands after its last look.

    gain: dB of PSNR on held-out views that the regularizer adds. time: what it adds to the time of a step, as a share.
    steps: of the trainings. error: the chance that each interval was allowed to miss.
    """

    comparison: Comparison
    steps: int
    error: float
    gain: Interval
    time: Interval
    verdict: Verdict

    def sentence(self, tolerance: float) -> str:
        """The verdict with its figures."""
        low, high = self.gain.low, self.gain.high
        match self.verdict:
            case Verdict.HELPS:
                return f"helps by {low:.2f} to {high:.2f} dB"
            case Verdict.HURTS:
                return f"hurts by {-high:.2f} to {-low:.2f} dB"
            case Verdict.NO_DIFFERENCE:
                return f"makes no difference beyond {tolerance:g} dB ({low:+.2f} to {high:+.2f} dB)"
        ends = "" if self.gain.count < 2 else f" ({low:+.2f} to {high:+.2f} dB)"
        return f"cannot tell{ends}"


def judge(gain: Interval, tolerance: float) -> Verdict:
    """The verdict that a gain in dB allows. A gain that is certain but below the tolerance makes no difference."""
    if gain.inside(tolerance):
        return Verdict.NO_DIFFERENCE
    if gain.low > 0:
        return Verdict.HELPS
    return Verdict.HURTS if gain.high < 0 else Verdict.CANNOT_TELL


def proposals(design: Design, findings: Mapping[Comparison, Finding]) -> tuple[Selection, ...]:
    """Smaller sets to be confirmed against the full one, in the order in which they are tried; the full set ends them.

    First what helps, and what saves time without hurting. Then those of which nothing can be said are put back, all
    at once; then those that make no difference, one by one, the best alone first, because two that can replace each
    other both seem to be of no use; what hurts comes last.
    """
    found = {
        f.comparison.regularizer: f
        for f in findings.values()
        if f.comparison.context is Context.SET
    }
    alone = {
        f.comparison.regularizer: f.gain.mean
        for f in findings.values()
        if f.comparison.context is Context.ALONE and f.gain.count
    }
    by_verdict = {
        verdict: [name for name, f in found.items() if f.verdict is verdict] for verdict in Verdict
    }
    saving = [
        name for name, f in found.items() if f.time.high < 0 and f.verdict is not Verdict.HURTS
    ]
    kept = [*by_verdict[Verdict.HELPS], *saving]
    chain = [design.ordered(kept)]
    spare = sorted(by_verdict[Verdict.NO_DIFFERENCE], key=lambda name: -alone.get(name, 0.0))
    for returned in (
        by_verdict[Verdict.CANNOT_TELL],
        *([name] for name in spare),
        by_verdict[Verdict.HURTS],
    ):
        kept += returned
        chain.append(design.ordered(kept))
    return tuple(dict.fromkeys(chain))
