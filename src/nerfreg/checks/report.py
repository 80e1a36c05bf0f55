"""What a check found."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

CHECKS = ("value", "gradient", "error", "invariance", "contract")
"""value: finite scalars, nothing edited. gradient: finite, and as finite differences have it. error: against exact
values. invariance: order and number of rays, scale. contract: bounds, samples, layers and needs as promised."""

LIMITS = {"float32": 1e-5, "float64": 1e-11}
"""Largest relative error against exact values."""


@dataclass(frozen=True)
class Spot:
    """Where something was checked. samples: None where their number does not matter."""

    case: str
    dtype: str
    samples: int | None = None

    @property
    def options(self) -> str:
        """For the command line."""
        samples = "" if self.samples is None else f" --samples {self.samples}"
        return f"--case {self.case} --dtype {self.dtype}{samples}"


@dataclass(frozen=True)
class Failure:
    """What was found wrong, by which of `CHECKS`, and where."""

    spot: Spot
    check: str
    message: str


@dataclass(frozen=True)
class Worst:
    """The largest relative error, and where it was. exact: against exact values, else against the plugin's own value
    in float64, which is for information."""

    error: float
    spot: Spot
    exact: bool


@dataclass
class Report:
    """All about one plugin.

    hook_points: by which the plugin takes part. overrides: of its configuration, as given on the command line.
    spots: where it was checked. checked: which of `CHECKS` applied to it. worst: for float32 and float64.
    """

    plugin: str
    hook_points: tuple[str, ...] = ()
    overrides: tuple[str, ...] = ()
    spots: set[Spot] = field(default_factory=set)
    checked: set[str] = field(default_factory=set)
    failures: list[Failure] = field(default_factory=list)
    worst: dict[str, Worst] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        return not self.failures

    @property
    def verdict(self) -> str:
        if self.failures:
            return "FAIL"
        return "ok" if self.checked else "n/a"

    def state(self, check: str) -> str:
        """One word about one of `CHECKS`."""
        if any(failure.check == check for failure in self.failures):
            return "FAIL"
        return "ok" if check in self.checked else "n/a"

    def judge(self, check: str, spot: Spot, wrong: list[str]) -> None:
        """Note that a check was made; each line of `wrong` is a failure."""
        self.spots.add(spot)
        self.checked.add(check)
        self.failures += [Failure(spot, check, line) for line in wrong]

    def measure(self, what: str, spot: Spot, error: float, limit: float) -> None:
        """Note an error against an exact value, a failure if it is above `limit`."""
        self._keep(Worst(error, spot, exact=True))
        wrong = (
            []
            if error <= limit
            else [f"{what}: relative error {error:.2g} against the exact value, limit {limit:g}"]
        )
        self.judge("error", spot, wrong)

    def inform(self, what: str, spot: Spot, error: float, limit: float) -> None:
        """The same against the plugin's own value in float64."""
        self._keep(Worst(error, spot, exact=False))
        if not error <= limit:
            self.judge(
                "error",
                spot,
                [f"{what}: {error:.2g} off its own value in float64, limit {limit:g}"],
            )

    def reproduction(self, spot: Spot) -> str:
        """The command line that shows a failure again."""
        return " ".join(["nerfreg check", self.plugin, spot.options, *self.overrides])

    def _keep(self, new: Worst) -> None:
        old = self.worst.get(new.spot.dtype)
        if old is None or math.isnan(new.error) or new.error > old.error:
            self.worst[new.spot.dtype] = new
