"""Numbers that change over a run."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

from nerfreg.errors import NerfregError, nearest

KINDS = ("constant", "linear", "exponential", "cosine", "piecewise")


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
