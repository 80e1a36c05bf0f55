"""What was found about a plugin."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from nerfreg.checks.accuracy import relative_error
from nerfreg.checks.subject import Subject
from nerfreg.errors import NerfregError, PluginError

CHECKS = {
    "value": "values are finite and in the rendering's type; nothing is edited",
    "gradient": "gradients are there, finite, and as finite differences have them",
    "error": "values are exact, to the digits of their type",
    "invariance": "order, number, chunks, threads and scale make no difference",
    "contract": "every hook returns what it specifies; promises are kept",
    "effects": "targets, weights, global generators and settings stay as they are",
    "steps": "no step raises, in any window; nothing of a step is kept after it",
    "cost": "work grows in proportion to the number of rays and of samples",
    "run": "a small run trains; the plugin made anew evaluates its checkpoint in the same way",
    "state": "a checkpoint restores all that the next step depends on",
}
"""All checks, with what holds where one is ok."""

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


class UnpreparedError(NerfregError):
    """A plugin cannot do without the files of a real scene."""


@dataclass
class Report:
    """All about one plugin.

    Attributes:
        subject: The plugin.
        spot: Where the checks stand now.
        spots: Where it was checked.
        checked: How often each of `CHECKS` was made.
        failures: What was found wrong.
        worst: The largest error in float32 and float64.
        skipped: Why some of `CHECKS` could not be made.
    """

    subject: Subject
    spot: Spot = Spot("", "")
    spots: set[Spot] = field(default_factory=set)
    checked: Counter[str] = field(default_factory=Counter)
    failures: list[Failure] = field(default_factory=list)
    worst: dict[str, Worst] = field(default_factory=dict)
    skipped: dict[str, str] = field(default_factory=dict)

    @contextmanager
    def at(self, spot: Spot, check: str) -> Iterator[None]:
        """Check something at a spot; whatever is raised there is a failure of `check`.

        A check for which a plugin wants the files of a real scene is skipped.
        """
        self.spot = spot
        try:
            yield
        except UnpreparedError as error:
            self.skip(check, str(error))
        except Exception as error:  # a foreign plugin may raise anything
            self.judge(check, [in_words(error)])

    def judge(self, check: str, wrong: Iterable[str]) -> None:
        """Note that a check was made; each line of `wrong` is a failure."""
        self.spots.add(self.spot)
        self.checked[check] += 1
        self.failures += [Failure(self.spot, check, line) for line in wrong]

    def skip(self, check: str, why: str) -> None:
        """Note why a check could not be made."""
        self.skipped.setdefault(check, why)

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
        return "ok" if self.checked.keys() & set(checks) else "n/a"

    @property
    def verdict(self) -> str:
        """The state of all checks together."""
        return self.state(*CHECKS)

    def reproduction(self, spot: Spot) -> str:
        """Return the command line that shows a failure again."""
        samples = "" if spot.samples is None else f" --samples {spot.samples}"
        where = f"--case {spot.case} --dtype {spot.dtype}{samples}"
        return " ".join(["nerfreg check", self.subject.name, where, *self.subject.overrides])


def in_words(error: Exception) -> str:
    """Return what was raised, in a line: by a plugin itself, not by the frame around it."""
    cause = error.__cause__ if isinstance(error, PluginError) else None
    if isinstance(error, PluginError) and cause is None:
        # Without the name of the plugin, which stands before.
        return str(error).rpartition("), ")[2].partition("\n")[0]
    raised = cause or error
    return f"raises {type(raised).__name__}: {raised}".partition("\n")[0]
