"""Reports printed: as tables for people, as JSON for programs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence

from nerfreg.checks.report import CHECKS, Report, Spot
from nerfreg.files import json_text

SHOWN = 5
"""How many different failures of one check are spelled out."""

INAPPLICABLE = {
    "value": "no terms and no layers",
    "gradient": "no terms and no layers",
    "error": "nothing that has an exact value",
    "invariance": "no terms",
    "contract": "no hook whose answer is more than terms",
    "effects": "no hook that is called in a step",
    "steps": "no hook that is called in a step",
    "cost": "no hook that is called in a step",
    "run": "no hook of a run",
    "state": "no hook of a run",
}
"""Why a check that was not made does not apply, where nothing else is known."""

COLUMNS: dict[str, Callable[[Report], str]] = {
    "plugin": lambda report: report.subject.name,
    "hooks": lambda report: " ".join(x.rpartition("_")[2] for x in report.subject.hook_points),
    "cases": lambda report: str(len(report.spots)),
    "value": lambda report: report.state("value"),
    "grad": lambda report: report.state("gradient"),
    "float32": lambda report: report.worst_error("float32"),
    "float64": lambda report: report.worst_error("float64"),
    "invar.": lambda report: report.state("invariance"),
    "contract": lambda report: report.state("contract"),
    "verdict": lambda report: report.verdict,
}
"""cases: combinations of case, precision and size. float32, float64: worst relative error."""


def print_reports(reports: Sequence[Report]) -> None:
    """Print a summary, a table for each plugin, and what failed.

    Each failure comes with the command line that shows it again.
    """
    rows = [[cell(report) for cell in COLUMNS.values()] for report in reports]
    widths = [max(map(len, column)) for column in zip(COLUMNS, *rows, strict=True)]
    for row in ([*COLUMNS], *rows):
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print("  ".join(cells).rstrip())
    if any("~" in cell for row in rows for cell in row):
        print("~ against the plugin's own value in float64; it ships no exact one")
    for lines in (_checks, _failures):
        for report in reports:
            print("".join(f"{line}\n" for line in lines(report)), end="")


def print_json(reports: Sequence[Report]) -> None:
    """Print one document, in which errors that are not finite are text."""

    def number(value: float) -> float | str:
        return value if math.isfinite(value) else str(value)

    passed = all(not report.failures for report in reports)
    plugins = [
        {
            "name": report.subject.name,
            "hook_points": report.subject.hook_points,
            "verdict": report.verdict,
            "cases": len(report.spots),
            "checks": {check: report.state(check) for check in CHECKS},
            "times_checked": {check: report.checked[check] for check in CHECKS},
            "skipped": {check: why for check, why in _skipped(report).items() if why},
            "worst": {
                dtype: {"error": number(worst.error), "exact": worst.exact, **vars(worst.spot)}
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
    print(json_text({"passed": passed, "plugins": plugins}, indent=2))


def _skipped(report: Report) -> dict[str, str]:
    """Why checks were not made, by check; nothing where they were."""
    return {
        check: "" if report.checked[check] else report.skipped.get(check, INAPPLICABLE[check])
        for check in CHECKS
    }


def _checks(report: Report) -> Iterator[str]:
    """What was checked and found, and what was skipped and why."""
    yield from ("", f"{report.subject.name}:")
    for check, why in _skipped(report).items():
        state = "skipped" if why else report.state(check)
        times = str(report.checked[check] or "")
        yield f"  {check:<10}  {state:<7}  {times:>4}  {why or CHECKS[check]}"
        if not why and check in report.skipped:
            yield f"{'':<27}in part: {report.skipped[check]}"


def _failures(report: Report) -> list[str]:
    """Each different failure once, by the first spot where it was found."""
    # By check, so that many failures of one do not hide those of another.
    name, found = report.subject.name, dict[str, dict[str, list[Spot]]]()
    for failure in report.failures:
        found.setdefault(failure.check, {}).setdefault(failure.message, []).append(failure.spot)
    lines = []
    for check, spots in found.items():
        for message, [first, *more] in list(spots.items())[:SHOWN]:
            lines += ["", f"{name}: {check}: {message}", f"    {report.reproduction(first)}"]
            if more:
                lines.append(f"    and {len(more)} times more, {_cases(more)}")
        if rest := list(spots.values())[SHOWN:]:
            cases = _cases(spot for others in rest for spot in others)
            lines += ["", f"{name}: {check}: {len(rest)} other failures, {cases}"]
    return lines


def _cases(spots: Iterable[Spot]) -> str:
    return f"in {', '.join(dict.fromkeys(spot.case for spot in spots))}"
