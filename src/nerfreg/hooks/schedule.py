"""Numbers that change over a run."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from nerfreg.errors import NerfregError, nearest

KINDS = ("constant", "linear", "exponential", "cosine", "piecewise")
EXAMPLE = "{schedule: linear, from: 1e-3, to: 0}"
NEEDED = {"constant": ("from",), "piecewise": ("points",)}
"""Keys that a schedule must have in a configuration; other kinds need two numbers, from and to."""


@dataclass(frozen=True)
class Schedule:
    """A number that depends on the share of the budget that is spent.

    Before `start` it is `first`, from `end` on it is `last`. With s from 0 to 1 in between, it is
    first + (last - first) s ("linear"), first^(1 - s) last^s ("exponential") or
    last + (first - last) (1 + cos(pi s)) / 2 ("cosine"). A "piecewise" one goes through `points`
    linearly, and a "constant" one stays at `first`.

    Attributes:
        kind: One of `KINDS`.
        first: The value at `start`.
        last: The value at `end`.
        start: Share of the budget, 0 to 1.
        end: Share of the budget, 0 to 1.
        points: Pairs of share and value in ascending order, for "piecewise" alone.
    """

    kind: str = "linear"
    first: float = 1.0
    last: float = 0.0
    start: float = 0.0
    end: float = 1.0
    points: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        """Raise NerfregError for a schedule that has no value somewhere."""
        if self.kind not in KINDS:
            raise NerfregError(f"schedule '{self.kind}'; {nearest(self.kind, KINDS)}")
        if not all(map(math.isfinite, self.values)):
            raise NerfregError(f"schedule {self.kind}: its values must be finite numbers")
        if self.kind == "piecewise":
            shares = [share for share, _ in self.points]
            if not shares or shares != sorted(set(shares)) or not 0 <= shares[0] <= shares[-1] <= 1:
                raise NerfregError(
                    "schedule piecewise: points must be pairs [share, value], "
                    "with shares that ascend from 0 to 1"
                )
        elif not 0 <= self.start < self.end <= 1:
            raise NerfregError(
                f"schedule {self.kind}: start={self.start:g} must be before end={self.end:g}, "
                "both shares of the budget from 0 to 1"
            )
        if self.kind == "exponential" and not (self.first > 0 and self.last > 0):
            raise NerfregError("schedule exponential: from and to must be positive")

    @classmethod
    def read(cls, mapping: Mapping[str, Any]) -> Schedule:
        """Read a schedule as it stands in a configuration.

        Args:
            mapping: `schedule` (the kind), and for it `from` ("constant"), `points` ("piecewise")
                or `from`, `to` and, if they are not 0 and 1, `start` and `end` (all others).

        Raises:
            NerfregError: It is no schedule; names key and value.
        """
        kind = mapping.get("schedule")
        if not isinstance(kind, str):
            raise NerfregError(f"a schedule names its kind, as in {EXAMPLE}")
        if kind not in KINDS:
            raise NerfregError(f"schedule={kind}: {nearest(kind, KINDS)}")
        needed = NEEDED.get(kind, ("from", "to"))
        known = ("schedule", *needed, *(("start", "end") if "to" in needed else ()))
        for key in map(str, mapping):
            if key not in known:
                hint = nearest(key, known)
                raise NerfregError(f"unknown key '{key}' in a {kind} schedule; {hint}")
        for key in needed:
            if key not in mapping:
                raise NerfregError(f"a {kind} schedule needs '{key}'")
        if kind == "piecewise":
            return cls(kind, points=_points(mapping["points"]))
        names = {"from": "first", "to": "last", "start": "start", "end": "end"}
        given = {key: value for key, value in mapping.items() if key != "schedule"}
        numbers: dict[str, Any] = {names[key]: _number(key, given[key]) for key in given}
        return cls(kind, **numbers)

    def written(self) -> dict[str, Any]:
        """Return the schedule as it stands in a configuration, without what is the default."""
        if self.kind == "piecewise":
            return {"schedule": self.kind, "points": [[*point] for point in self.points]}
        whole = {"schedule": self.kind, "from": self.first}
        if self.kind == "constant":
            return whole
        window = {"start": self.start} if self.start != 0 else {}
        window |= {"end": self.end} if self.end != 1 else {}
        return {**whole, "to": self.last, **window}

    @property
    def values(self) -> tuple[float, ...]:
        """The values at its corners; all others lie between the least and the greatest of them."""
        if self.kind == "piecewise":
            return tuple(value for _, value in self.points)
        return (self.first,) if self.kind == "constant" else (self.first, self.last)

    def at(self, fraction: float) -> float:
        """Return the value when this share of the budget is spent."""
        if self.kind == "piecewise":
            return self._between_points(fraction)
        if self.kind == "constant" or fraction <= self.start:
            return self.first
        if fraction >= self.end:
            return self.last
        s = (fraction - self.start) / (self.end - self.start)
        if self.kind == "exponential":
            return math.exp((1 - s) * math.log(self.first) + s * math.log(self.last))
        if self.kind == "cosine":
            s = (1 - math.cos(math.pi * s)) / 2
        return self.first + (self.last - self.first) * s

    def _between_points(self, fraction: float) -> float:
        after = bisect_right([share for share, _ in self.points], fraction)
        if after in (0, len(self.points)):
            return self.points[max(after - 1, 0)][1]
        (first, low), (last, high) = self.points[after - 1 : after + 1]
        return low + (high - low) * (fraction - first) / (last - first)


def _number(key: str, value: object) -> float:
    # YAML reads 1e-3 without a decimal point as a string, which float understands.
    if not isinstance(value, bool) and isinstance(value, int | float | str):
        try:
            return float(value)
        except ValueError:
            pass
    raise NerfregError(f"{key}={value}: must be a number")


def _points(value: object) -> tuple[tuple[float, float], ...]:
    wanted = "must be pairs [share, value], as in [[0, 1e-3], [0.5, 0]]"
    if not isinstance(value, list) or not value:
        raise NerfregError(f"points={value}: {wanted}")
    for point in value:
        if not isinstance(point, list) or len(point) != 2:
            raise NerfregError(f"points={value}: {wanted}")
    return tuple((_number("points", share), _number("points", at)) for share, at in value)
