"""What was found about a plugin: as a table for people, as JSON for programs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from nerfreg.checks.accuracy import relative_error
from nerfreg.checks.driver import Subject
from nerfreg.files import json_text

CHECKS = ("value", "gradient", "error", "invariance", "contract")
"""value: finite scalars, nothing edited. gradient: finite, and as finite differences have it.
error: against exact values. invariance: to order and number of rays, and to scale. contract:
bounds, samples, layers and needs as promised."""

LIMITS = {"float32": 1e-5, "float64": 1e-11}
"""Largest relative error against exact values."""

OWN_LIMIT = 1e-3
"""Largest relative error against a plugin's own value in float64, where it ships no exact one."""

SHOWN = 5
"""How many different failures of one plugin are spelled out."""


@dataclass(frozen=True)
class Spot:
    """Where something was checked; `samples` is None where their number does not matter."""

    case: str
    dtype: str
    samples: int | None = None


@dataclass(frozen=True)
class Failure:
    """What was found wrong, by which of `CHECKS`, and where."""

    spot: Spot
    check: str
    message: str


@dataclass(frozen=True)
class Worst:
    """The largest relative error, where it was, and whether it is against an exact value."""

    error: float
    spot: Spot
    exact: bool


@dataclass
class Report:
    """All about one plugin.

    Attributes:
        subject: The plugin.
        spot: Where the checks stand now.
        spots: Where it was checked.
        checked: Which of `CHECKS` applied to it.
        failures: What was found wrong.
        worst: The largest error in float32 and float64.
    """

    subject: Subject
    spot: Spot = Spot("", "")
    spots: set[Spot] = field(default_factory=set)
    checked: set[str] = field(default_factory=set)
    failures: list[Failure] = field(default_factory=list)
    worst: dict[str, Worst] = field(default_factory=dict)

    @contextmanager
    def at(self, spot: Spot, check: str) -> Iterator[None]:
        """Check something at a spot; whatever is raised there is a failure of `check`."""
        self.spot = spot
        try:
            yield
        except Exception as error:  # a foreign plugin may raise anything
            self.judge(check, [f"raises {type(error).__name__}: {error}".partition("\n")[0]])

    def judge(self, check: str, wrong: Iterable[str]) -> None:
        """Note that a check was made; each line of `wrong` is a failure."""
        self.spots.add(self.spot)
        self.checked.add(check)
        self.failures += [Failure(self.spot, check, line) for line in wrong]

    def compare(
        self,
        values: Mapping[str, Any],
        truth: Mapping[str, Any],
        label: str = "{}",
        limits: Mapping[str, float] = LIMITS,
    ) -> None:
        """Compare the values that have an exact one with it, in precisions that have a limit."""
        limit = limits.get(self.spot.dtype, 0.0)
        for name in values if limit else ():
            if name in truth and values[name] is not None:
                error = self._error_of(values[name], truth[name], exact=True)
                against = f"against the exact value, limit {limit:g}"
                line = f"{label.format(name)}: relative error {error:.2g} {against}"
                self.judge("error", [] if error <= limit else [line])

    def compare_own(self, what: str, value: Tensor, own: Tensor) -> None:
        """Compare a value with the one that the plugin itself computes in float64."""
        error = self._error_of(value, own, exact=False)
        if not error <= OWN_LIMIT:
            message = f"{error:.2g} off its own value in float64, limit {OWN_LIMIT:g}"
            self.judge("error", [f"{what}: {message}"])

    def _error_of(self, values: Any, truth: Any, exact: bool) -> float:
        dtype = self.spot.dtype
        error, old = relative_error(values, truth, dtype), self.worst.get(dtype)
        if old is None or math.isnan(error) or error > old.error:
            self.worst[dtype] = Worst(error, self.spot, exact)
        return error

    def worst_error(self, dtype: str) -> str:
        """Return the largest error in words, with ~ if it is not against an exact value."""
        worst = self.worst.get(dtype)
        return "n/a" if worst is None else f"{'' if worst.exact else '~'}{worst.error:.1e}"

    def state(self, *checks: str) -> str:
        """Return FAIL if any of these checks failed, n/a if none applied, else ok."""
        if any(failure.check in checks for failure in self.failures):
            return "FAIL"
        return "ok" if self.checked.intersection(checks) else "n/a"

    @property
    def verdict(self) -> str:
        """The state of all checks together."""
        return self.state(*CHECKS)

    def reproduction(self, spot: Spot) -> str:
        """Return the command line that shows a failure again."""
        samples = "" if spot.samples is None else f" --samples {spot.samples}"
        where = f"--case {spot.case} --dtype {spot.dtype}{samples}"
        return " ".join(["nerfreg check", self.subject.name, where, *self.subject.overrides])


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
    """Print a table, then the failures, each with the command line that shows it again."""
    rows = [[cell(report) for cell in COLUMNS.values()] for report in reports]
    widths = [max(map(len, column)) for column in zip(COLUMNS, *rows, strict=True)]
    for row in ([*COLUMNS], *rows):
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print("  ".join(cells).rstrip())
    if any("~" in cell for row in rows for cell in row):
        print("~ against the plugin's own value in float64; it ships no exact one")
    for report in reports:
        print("".join(f"{line}\n" for line in _failures(report)), end="")


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


def _failures(report: Report) -> list[str]:
    """Each different failure once, by the first spot where it was found."""
    name, spots = report.subject.name, dict[str, list[Spot]]()
    for failure in report.failures:
        spots.setdefault(f"{failure.check}: {failure.message}", []).append(failure.spot)
    lines = []
    for message, [first, *more] in list(spots.items())[:SHOWN]:
        lines += ["", f"{name}: {message}", f"    {report.reproduction(first)}"]
        if more:
            lines.append(f"    and {len(more)} times more, {_cases(more)}")
    if rest := list(spots.values())[SHOWN:]:
        cases = _cases(spot for found in rest for spot in found)
        lines += ["", f"{name}: {len(rest)} other failures, {cases}"]
    return lines


def _cases(spots: Iterable[Spot]) -> str:
    return f"in {', '.join(dict.fromkeys(spot.case for spot in spots))}"
