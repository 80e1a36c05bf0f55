"""What a study tells: two tables, a few sentences, and a record of all that they come from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from itertools import groupby
from statistics import fmean
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

from nerfreg.analysis.pareto import front
from nerfreg.analysis.statistics import ERROR, Interval
from nerfreg.analysis.tables import build_table, numbers, text
from nerfreg.prune.advice import budget_needed, cells_to_judge
from nerfreg.prune.ledger import Difference, Verdict
from nerfreg.prune.plan import Context, Selection, StudyCell
from nerfreg.prune.study import Study


class RankedSet(NamedTuple):
    """A set minus the full one, and whether it is on the Pareto front of error and time."""

    regularizers: Selection
    found: Difference
    on_front: bool


def ranked_sets(study: Study) -> list[RankedSet]:
    """Compare every set that was trained: the longest trainings first, of these the best first.

    The front is that of trainings of as many steps, because sets that look good early often do not
    in the end. Intervals are plain ones of 95 %.
    """
    full, ledger = study.design.full, study.ledger
    ranked: list[RankedSet] = []
    for steps in reversed(study.design.ladder):
        cells: dict[Selection, list[StudyCell]] = {}
        for trial in ledger.trials:
            if trial.steps == steps:
                cells.setdefault(trial.regularizers, []).append((trial.held_out, trial.seed))
        known = [
            (names, found)
            for names, own in cells.items()
            if (found := ledger.difference(names, full, own, steps, ERROR)).gain.count
        ]
        best = front([(-found.gain.mean, found.time.mean) for _, found in known])
        level = [RankedSet(*entry, index in best) for index, entry in enumerate(known)]
        ranked += sorted(level, key=lambda entry: -entry.found.gain.mean)
    return ranked


def print_report(study: Study, scene: str, console: Console) -> None:
    """Print both tables, then what they come to."""
    console.print(_contributions(study, scene))
    console.print(_sets(study))
    for line in conclusions(study):
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def _contributions(study: Study, scene: str) -> Table:
    rows = []
    for name, found in study.findings[Context.SET].items():
        alone = study.findings[Context.ALONE][name]
        figures = ends(found.gain), ends(alone.gain), ends(found.time, 100.0, 0)
        verdict = found.verdict(study.tolerance).value
        rows.append((name, *figures, str(found.steps), str(found.gain.count), verdict))
    columns = numbers("in the set, dB", "alone, dB", "time, %", "steps", "n")
    return build_table(
        f"What each regularizer adds: {scene}, {study.design.views} training views",
        f"dB of PSNR on held-out training views ({len(study.design.folds)} folds); in the set: the "
        "full set against it without this one; alone: this one against vanilla. time: what it adds "
        "to a step of the set. n: cells (fold, seed). Intervals hold together, for all verdicts "
        f"and looks, with {100 * (1 - ERROR):g} % confidence. No test view was read.",
        [*text("regularizer"), *columns, *text("verdict")],
        rows,
    )


def _sets(study: Study) -> Table:
    ranked, full = ranked_sets(study), study.design.full
    average = ["average"] if any(entry.found.average is not None for entry in ranked) else []
    table = build_table(
        f"Sets, against the full one{_level(study)}",
        "* on the Pareto front of error and time, by the means, of as many steps. Intervals of "
        "95 % each, over the cells that a set shares with the full one.",
        [*text("", "set"), *numbers("dB", "95 %", *average, "time, %", "steps", "n")],
        [],
    )
    for steps, level in groupby(ranked, key=lambda entry: entry.found.steps):
        for names, found, on_front in level:
            row = ["*" if on_front else "", study.design.label(names), f"{found.gain.mean:+.2f}"]
            row += ["" if names == full else ends(found.gain)]
            row += ["" if found.average is None else f"{found.average:+.4f}" for _ in average]
            row += [f"{100 * found.time.mean:+.0f}", str(steps), str(found.gain.count)]
            table.add_row(*row)
        table.add_section()
    return table


def _level(study: Study) -> str:
    psnr: dict[int, list[float]] = {}
    for trial, measured in study.ledger.trials.items():
        if trial.regularizers == study.design.full and measured.psnr is not None:
            psnr.setdefault(trial.steps, []).append(measured.psnr)
    return f" ({fmean(psnr[max(psnr)]):.2f} dB after {max(psnr)} steps)" if psnr else ""


def ends(interval: Interval, factor: float = 1.0, digits: int = 2, between: str = "..") -> str:
    """Return both ends of an interval, as `-0.10..+0.35`; `?` where they are unknown."""
    if interval.count < 2:
        return "?"
    return f"{factor * interval.low:+.{digits}f}{between}{factor * interval.high:+.{digits}f}"


def conclusions(study: Study) -> Iterator[str]:
    """Say what was found, a sentence a line."""
    for name, found in study.findings[Context.SET].items():
        yield f"{name}: {finding_sentence(found, study.tolerance)}"
    for names, found in study.confirmations.items():
        yield f"{'+'.join(names) or 'vanilla'} against the full set: {_confirmed(study, found)}."
    if study.dropped:
        kept = ", ".join(study.pruned) or "nothing (vanilla)"
        yield f"Pruned set: {kept}. Dropped: {', '.join(study.dropped)}."
    elif len(study.proposals) == 1:
        yield "Every regularizer stays."
    elif not study.confirmations:
        yield "There was no time to confirm a smaller set: every regularizer stays."
    else:
        yield "No smaller set could be shown to be as good: every regularizer stays."
    seconds = budget_needed(study)
    if seconds is not None:
        time = duration(seconds)
        yield f"To tell more, a budget of about {time} would probably do: --budget {seconds}."


def duration(seconds: int) -> str:
    """Return `90 min`, or `2.5 h` from two hours on."""
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def finding_sentence(found: Difference, tolerance: float) -> str:
    """Return a verdict with its figures, or what it would take to have one."""
    low, high, both = found.gain.low, found.gain.high, ends(found.gain, between=" to ")
    match found.verdict(tolerance):
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


def _confirmed(study: Study, found: Difference) -> str:
    within = f"worse by more than {study.tolerance:g} dB"
    verdicts = {True: f"confirmed, not {within}", False: f"refused, {within}", None: "cannot tell"}
    figures = f"{ends(found.gain)} dB, {100 * found.time.mean:+.0f} % time, "
    cells = f"{found.gain.count} cells of {found.steps} steps"
    verdict = verdicts[found.no_worse(study.tolerance)]
    return f"{figures if found.gain.count > 1 else ''}{cells}: {verdict}"


def record(study: Study) -> dict[str, Any]:
    """Return everything that the study measured and concluded, for `prune.json`."""
    design, tolerance = study.design, study.tolerance
    return {
        "views": design.views,
        "budget": study.budget,
        "spent": study.ledger.spent,
        "tolerance": tolerance,
        "design": {**asdict(design), "first_look": design.first_look},
        "contributions": [
            {"regularizer": name, "context": context, "having": pair[0], "lacking": pair[1]}
            | _figures(found, "steps", "error", "gain", "time")
            | {"verdict": found.verdict(tolerance)}
            for context, findings in study.findings.items()
            for name, found in findings.items()
            for pair in [design.pair(name, context)]
        ],
        "sets": [
            {"regularizers": names, "on_front": on_front}
            | _figures(found, "steps", "gain", "time", "average")
            for names, found, on_front in ranked_sets(study)
        ],
        "proposals": study.proposals,
        "confirmations": [
            {"regularizers": names, "passed": found.no_worse(tolerance)}
            | _figures(found, "error", "gain", "time")
            for names, found in study.confirmations.items()
        ],
        "pruned": study.pruned,
        "dropped": study.dropped,
        "budget_needed": budget_needed(study),
        "trials": [asdict(trial) | asdict(m) for trial, m in study.ledger.trials.items()],
    }


def _figures(found: Difference, *names: str) -> dict[str, Any]:
    figures = asdict(found)
    return {name: figures[name] for name in names}
