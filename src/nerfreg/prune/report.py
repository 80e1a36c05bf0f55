"""What a study tells: two tables, a few sentences, and a record of all that they come from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from statistics import fmean
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

from nerfreg.analysis.pareto import front
from nerfreg.analysis.statistics import ERROR, Interval
from nerfreg.analysis.tables import new_table
from nerfreg.prune.advice import budget_needed, cells_to_judge
from nerfreg.prune.ledger import Difference, Ledger
from nerfreg.prune.plan import Context, Design, Selection
from nerfreg.prune.study import Study, StudyResult
from nerfreg.prune.verdicts import Verdict, judge, no_worse


class RankedSet(NamedTuple):
    """A set against the full one, and whether it is on the Pareto front of error and time."""

    regularizers: Selection
    found: Difference
    on_front: bool


def ranked_sets(design: Design, ledger: Ledger) -> list[RankedSet]:
    """Compare every set that was trained: the longest trainings first, of these the best first.

    The front is that of trainings of as many steps: sets that look good early often do not later.
    Intervals are plain ones of 95 %.
    """
    ranked: list[RankedSet] = []
    for steps in reversed(design.ladder):
        cells: dict[Selection, list[Any]] = {}
        for trial in ledger.trials:
            if trial.steps == steps:
                cells.setdefault(trial.regularizers, []).append(trial.cell)
        level = [
            (names, found)
            for names, own in cells.items()
            if (found := ledger.difference(names, design.full, own, steps, ERROR)).gain.count
        ]
        best = front([(-found.gain.mean, found.time.mean) for _, found in level])
        points = [RankedSet(*entry, index in best) for index, entry in enumerate(level)]
        ranked += sorted(points, key=lambda point: -point.found.gain.mean)
    return ranked


def print_report(study: Study, result: StudyResult, scene: str, console: Console) -> None:
    """Print both tables, then what they come to."""
    console.print(_contributions(study, result, scene))
    console.print(_sets(study))
    for line in conclusions(study, result):
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def _contributions(study: Study, result: StudyResult, scene: str) -> Table:
    folds = study.design.folds
    table = new_table(
        f"What each regularizer adds: {scene}, {sum(map(len, folds))} training views",
        f"dB of PSNR on held-out training views ({len(folds)} folds); in the set: the full set "
        "against it without this one; alone: this one against vanilla. time: what it adds to a "
        "step of the set. n: cells (fold, seed). Intervals hold together, for all verdicts and "
        f"looks, with {100 * (1 - ERROR):g} % confidence. No test view was read.",
    )
    table.add_column("regularizer", no_wrap=True)
    for header in ("in the set, dB", "alone, dB", "time, %", "steps", "n"):
        table.add_column(header, justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    for name, found in result.findings[Context.SET].items():
        alone = result.findings[Context.ALONE][name]
        figures = ends(found.gain), ends(alone.gain), ends(found.time, 100.0, 0)
        verdict = judge(found.gain, study.tolerance)
        table.add_row(name, *figures, str(found.steps), str(found.gain.count), verdict.value)
    return table


def _sets(study: Study) -> Table:
    ranked = ranked_sets(study.design, study.ledger)
    averages = any(point.found.average is not None for point in ranked)
    table = new_table(
        f"Sets, against the full one{_level(study)}",
        "* on the Pareto front of error and time, by the means, of as many steps. Intervals of "
        "95 % each, over the cells that a set shares with the full one.",
    )
    for header in ("", "set"):
        table.add_column(header, no_wrap=True)
    for header in ("dB", "95 %", *(["average"] if averages else []), "time, %", "steps", "n"):
        table.add_column(header, justify="right", no_wrap=True)
    for (names, found, on_front), below in zip(ranked, [*ranked[1:], None], strict=True):
        average = "" if found.average is None else f"{found.average:+.4f}"
        table.add_row(
            "*" if on_front else "",
            study.design.label(names),
            f"{found.gain.mean:+.2f}",
            "" if names == study.design.full else ends(found.gain),
            *([average] if averages else []),
            f"{100 * found.time.mean:+.0f}",
            str(found.steps),
            str(found.gain.count),
            end_section=below is None or below.found.steps != found.steps,
        )
    return table


def _level(study: Study) -> str:
    """Say what the full set reaches after its longest trainings."""
    full = [
        (t.steps, m.psnr)
        for t, m in study.ledger.trials.items()
        if t.regularizers == study.design.full
    ]
    steps = max((steps for steps, psnr in full if psnr is not None), default=0)
    values = [psnr for own, psnr in full if own == steps and psnr is not None]
    return f" ({fmean(values):.2f} dB after {steps} steps)" if values else ""


def ends(interval: Interval, factor: float = 1.0, digits: int = 2, between: str = "..") -> str:
    """Return both ends of an interval, as `-0.10..+0.35`; `?` where they are unknown."""
    if interval.count < 2:
        return "?"
    return f"{factor * interval.low:+.{digits}f}{between}{factor * interval.high:+.{digits}f}"


def conclusions(study: Study, result: StudyResult) -> Iterator[str]:
    """Say what was found, a sentence a line."""
    for name, found in result.findings[Context.SET].items():
        yield f"{name}: {finding_sentence(found, study.tolerance)}"
    for names, found in result.confirmations.items():
        yield _confirmation_sentence(names, found, study.tolerance)
    dropped = [name for name in study.design.full if name not in result.pruned]
    if dropped:
        kept = ", ".join(result.pruned) or "nothing (vanilla)"
        yield f"Pruned set: {kept}. Dropped: {', '.join(dropped)}."
    elif len(result.proposals) == 1:
        yield "Every regularizer stays."
    elif not result.confirmations:
        yield "There was no time to confirm a smaller set: every regularizer stays."
    else:
        yield "No smaller set could be shown to be as good: every regularizer stays."
    seconds = budget_needed(study, result)
    if seconds is not None:
        time = f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
        yield f"To tell more, a budget of about {time} would probably do: --budget {seconds}."


def finding_sentence(found: Difference, tolerance: float) -> str:
    """Return a verdict with its figures, and with what it would take where it is none."""
    low, high, both = found.gain.low, found.gain.high, ends(found.gain, between=" to ")
    match judge(found.gain, tolerance):
        case Verdict.HELPS:
            return f"helps by {low:.2f} to {high:.2f} dB"
        case Verdict.HURTS:
            return f"hurts by {-high:.2f} to {-low:.2f} dB"
        case Verdict.NO_DIFFERENCE:
            return f"makes no difference beyond {tolerance:g} dB ({both} dB)"
    if found.gain.count < 2:
        return "cannot tell: too few cells"
    cells = cells_to_judge(found, tolerance)
    number = "thousands of" if cells is None else f"about {cells}"
    return f"cannot tell ({both} dB); {number} cells would, there are {found.gain.count}"


def _confirmation_sentence(names: Selection, found: Difference, tolerance: float) -> str:
    verdict = {
        True: f"confirmed, not worse by more than {tolerance:g} dB",
        False: f"refused, worse by more than {tolerance:g} dB",
        None: "cannot tell",
    }[no_worse(found.gain, tolerance)]
    count, time = found.gain.count, f"{100 * found.time.mean:+.0f} % time"
    figures = "" if count < 2 else f"{ends(found.gain)} dB, {time}, "
    label = "+".join(names) or "vanilla"
    return (
        f"{label} against the full set: {figures}{count} cells of {found.steps} steps: {verdict}."
    )


def record(study: Study, result: StudyResult, scene: str) -> dict[str, Any]:
    """Return everything that the study measured and concluded, for `prune.json`."""
    design, ledger = study.design, study.ledger
    return {
        "scene": scene,
        "views": sum(map(len, design.folds)),
        "budget": study.budget,
        "spent": ledger.spent,
        "tolerance": study.tolerance,
        "design": {**asdict(design), "first_look": design.first_look},
        "contributions": [
            {"regularizer": name, "context": context}
            | dict(zip(("having", "lacking"), design.pair(name, context), strict=True))
            | _figures(found, "steps", "error", "gain", "time")
            | {"verdict": judge(found.gain, study.tolerance)}
            for context, findings in result.findings.items()
            for name, found in findings.items()
        ],
        "sets": [
            {"regularizers": names}
            | _figures(found, "steps", "gain", "time", "average")
            | {"on_front": on_front}
            for names, found, on_front in ranked_sets(design, ledger)
        ],
        "proposals": result.proposals,
        "confirmations": [
            {"regularizers": names}
            | _figures(found, "error", "gain", "time")
            | {"passed": no_worse(found.gain, study.tolerance)}
            for names, found in result.confirmations.items()
        ],
        "pruned": result.pruned,
        "dropped": [name for name in design.full if name not in result.pruned],
        "budget_needed": budget_needed(study, result),
        "trials": [asdict(trial) | asdict(m) for trial, m in ledger.trials.items()],
    }


def _figures(found: Difference, *keys: str) -> dict[str, Any]:
    figures = asdict(found)
    return {key: figures[key] for key in keys}
