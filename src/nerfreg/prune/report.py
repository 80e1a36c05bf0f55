"""What a study tells: two tables and a few sentences."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import fmean

from rich.console import Console
from rich.table import Table

from nerfreg.analysis.statistics import ERROR, Interval
from nerfreg.analysis.tables import new_table
from nerfreg.prune.advice import cells_to_judge
from nerfreg.prune.plan import Context, Design
from nerfreg.prune.study import Confirmation
from nerfreg.prune.summary import Summary, set_points
from nerfreg.prune.verdicts import Finding, Verdict


def print_report(summary: Summary, console: Console) -> None:
    """Both tables, then what they come to."""
    console.print(_contributions(summary))
    console.print(_sets(summary))
    for line in conclusions(summary):
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def _contributions(summary: Summary) -> Table:
    cells = len(summary.design.folds)
    table = new_table(
        f"What each regularizer adds: {summary.scene}, {summary.views} training views",
        f"dB of PSNR on held-out training views ({cells} folds); in the set: the full set against it without this one; "
        f"alone: this one against vanilla. time: what it adds to a step of the set. n: cells (fold, seed). Intervals "
        f"hold together, for all verdicts and looks, with {100 * (1 - ERROR):g} % confidence. No test view was read.",
    )
    table.add_column("regularizer", no_wrap=True)
    for header in ("in the set, dB", "alone, dB", "time, %", "steps", "n"):
        table.add_column(header, justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    alone = {
        f.comparison.regularizer: f
        for f in summary.outcome.findings.values()
        if f.comparison.context is Context.ALONE
    }
    for finding in summary.outcome.contributions:
        name = finding.comparison.regularizer
        table.add_row(
            name,
            ends(finding.gain),
            ends(alone[name].gain),
            ends(finding.time, 100.0, 0),
            str(finding.steps),
            str(finding.gain.count),
            finding.verdict.value,
        )
    return table


def _sets(summary: Summary) -> Table:
    points = set_points(summary.design, summary.ledger)
    table = new_table(
        f"Sets, against the full one{_level(summary)}",
        "* on the Pareto front of error and time, by the means, of as many steps. Intervals of 95 % each, over the "
        "cells that a set shares with the full one.",
    )
    table.add_column("", no_wrap=True)
    table.add_column("set", no_wrap=True)
    averages = any(point.average is not None for point in points)
    for header in ("dB", "95 %", *(["average"] if averages else []), "time, %", "steps", "n"):
        table.add_column(header, justify="right", no_wrap=True)
    for point, below in zip(points, [*points[1:], None], strict=False):
        table.add_row(
            "*" if point.on_front else "",
            summary.design.label(point.regularizers),
            f"{point.gain.mean:+.2f}",
            "" if point.regularizers == summary.design.full else ends(point.gain),
            *([("" if point.average is None else f"{point.average:+.4f}")] if averages else []),
            f"{100 * point.time.mean:+.0f}",
            str(point.steps),
            str(point.gain.count),
            end_section=below is None or below.steps != point.steps,
        )
    return table


def _level(summary: Summary) -> str:
    """What the full set has, after its longest trainings."""
    trained = [
        (t.steps, m.psnr)
        for t, m in summary.ledger.trials.items()
        if t.regularizers == summary.design.full
    ]
    steps = max((steps for steps, psnr in trained if psnr is not None), default=0)
    values = [psnr for own, psnr in trained if own == steps and psnr is not None]
    return f" ({fmean(values):.2f} dB after {steps} steps)" if values else ""


def ends(interval: Interval, factor: float = 1.0, digits: int = 2) -> str:
    """-0.10..+0.35"""
    if interval.count < 2:
        return "?"
    return f"{factor * interval.low:+.{digits}f}..{factor * interval.high:+.{digits}f}"


def conclusions(summary: Summary) -> Iterator[str]:
    """What was found, in sentences."""
    outcome, design = summary.outcome, summary.design
    for finding in outcome.contributions:
        yield f"{finding.comparison.regularizer}: {finding.sentence(summary.tolerance)}{_more(finding, summary)}"
    for confirmation in outcome.confirmations:
        yield confirmation_sentence(confirmation, design, summary.tolerance)
    dropped = [name for name in design.full if name not in outcome.pruned]
    if dropped:
        yield f"Pruned set: {', '.join(outcome.pruned) or 'nothing (vanilla)'}. Dropped: {', '.join(dropped)}."
    elif len(outcome.proposals) == 1:
        yield "Every regularizer stays."
    elif not outcome.confirmations:
        yield "There was no time to confirm a smaller set: every regularizer stays."
    else:
        yield "No smaller set could be shown to be as good: every regularizer stays."
    if (seconds := summary.advice) is not None:
        yield f"To tell more, a budget of about {duration(seconds)} would probably do: --budget {seconds}."


def _more(finding: Finding, summary: Summary) -> str:
    if finding.verdict is not Verdict.CANNOT_TELL:
        return ""
    if finding.gain.count < 2:
        return ": too few cells"
    cells = cells_to_judge(finding, summary.tolerance)
    return f"; {'thousands of' if cells is None else f'about {cells}'} cells would, there are {finding.gain.count}"


def confirmation_sentence(confirmation: Confirmation, design: Design, tolerance: float) -> str:
    """A proposed set against the full one, with its figures."""
    verdict = {
        True: f"confirmed, not worse by more than {tolerance:g} dB",
        False: f"refused, worse by more than {tolerance:g} dB",
        None: "cannot tell",
    }[confirmation.passed]
    gain, time = confirmation.gain, confirmation.time
    figures = "" if gain.count < 2 else f"{ends(gain)} dB, {100 * time.mean:+.0f} % time, "
    names = "+".join(confirmation.regularizers) or "vanilla"
    return f"{names} against the full set: {figures}{gain.count} cells of {design.ladder[-1]} steps: {verdict}."


def duration(seconds: int) -> str:
    """90 min"""
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
