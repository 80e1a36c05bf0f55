"""Reports for people, as a table, and for programs, as JSON."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table

from nerfreg.checks.report import CHECKS, Report, Spot

SHOWN = 5
"""Different failures of one plugin that are spelled out."""

COLUMNS = (
    "plugin",
    "hooks",
    "cases",
    "value",
    "grad",
    "float32",
    "float64",
    "invar.",
    "contract",
    "verdict",
)
"""cases: how many combinations of case, precision and size. float32, float64: the worst relative error."""

FOOTNOTE = "~ against the plugin's own value in float64; it ships no exact one"


def print_reports(reports: Sequence[Report]) -> None:
    """A table, then the failures, each with the command line that shows it again; plain where no terminal is."""
    rows = [_row(report) for report in reports]
    if sys.stdout.isatty():
        table = Table(*COLUMNS, box=None, pad_edge=False)
        for row in rows:
            table.add_row(*row)
        Console(markup=False, highlight=False).print(table)
    else:
        print(_plain(COLUMNS, rows))
    if any("~" in cell for row in rows for cell in row):
        print(FOOTNOTE)
    for report in reports:
        print(_failures(report), end="")


def as_json(reports: Sequence[Report]) -> str:
    """One document; errors that are not finite are written as text."""
    plugins = [
        {
            "name": report.plugin,
            "hook_points": list(report.hook_points),
            "verdict": report.verdict,
            "cases": len(report.spots),
            "checks": {check: report.state(check) for check in CHECKS},
            "worst": {
                dtype: {"error": _number(worst.error), "exact": worst.exact, **vars(worst.spot)}
                for dtype, worst in sorted(report.worst.items())
            },
            "failures": [
                {
                    **vars(failure.spot),
                    "check": failure.check,
                    "message": failure.message,
                    "reproduce": report.reproduction(failure.spot),
                }
                for failure in report.failures
            ],
        }
        for report in reports
    ]
    return json.dumps(
        {"passed": all(report.passed for report in reports), "plugins": plugins}, indent=2
    )


def _row(report: Report) -> tuple[str, ...]:
    return (
        report.plugin,
        " ".join(point.rpartition("_")[2] for point in report.hook_points),
        str(len(report.spots)),
        report.state("value"),
        report.state("gradient"),
        _error(report, "float32"),
        _error(report, "float64"),
        report.state("invariance"),
        report.state("contract"),
        report.verdict,
    )


def _error(report: Report, dtype: str) -> str:
    worst = report.worst.get(dtype)
    return "n/a" if worst is None else f"{'' if worst.exact else '~'}{worst.error:.1e}"


def _number(value: float) -> float | str:
    return value if math.isfinite(value) else str(value)


def _plain(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    lines = (
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        for row in (header, *rows)
    )
    return "\n".join(line.rstrip() for line in lines)


def _failures(report: Report) -> str:
    """Each different failure once, by the first spot where it was found."""
    spots: dict[tuple[str, str], list[Spot]] = {}
    for failure in report.failures:
        spots.setdefault((failure.check, failure.message), []).append(failure.spot)
    lines = []
    for (check, message), found in list(spots.items())[:SHOWN]:
        lines += [
            "",
            f"{report.plugin}: {check}: {message}",
            f"    {report.reproduction(found[0])}",
        ]
        if found[1:]:
            lines.append(f"    and {len(found) - 1} times more, {_cases(found[1:])}")
    if rest := list(spots.values())[SHOWN:]:
        lines += [
            "",
            f"{report.plugin}: {len(rest)} other failures, {_cases(spot for found in rest for spot in found)}",
        ]
    return "".join(f"{line}\n" for line in lines)


def _cases(spots: Iterable[Spot]) -> str:
    return f"in {', '.join(dict.fromkeys(spot.case for spot in spots))}"
