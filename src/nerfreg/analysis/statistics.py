"""Intervals of means from few differences, and how few would have been enough."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from statistics import fmean, stdev

import mpmath
import numpy as np

ERROR = 0.05
"""Chance that any verdict of a study is wrong, at most."""

MOST_CELLS = 4096


@dataclass(frozen=True)
class Interval:
    """Mean of a few differences, and the ends between which the true mean lies unless one is unlucky.

    count: how many. deviation: their standard deviation; nan where there is none. Fewer than two differences say
    nothing about their spread: the ends are infinite then.
    """

    mean: float
    low: float
    high: float
    count: int
    deviation: float

    def inside(self, limit: float) -> bool:
        """Whether the whole interval lies in [-limit, limit]."""
        return -limit <= self.low and self.high <= limit


@cache
def student_quantile(error: float, freedom: int) -> float:
    """t with P(|T| > t) = error for Student's t with this many degrees of freedom.

    P(|T| > t) is the regularized incomplete beta function I_x(freedom / 2, 1 / 2) at x = freedom / (freedom + t^2).
    """

    def tail(t: float) -> float:
        return float(
            mpmath.betainc(freedom / 2, 0.5, 0, freedom / (freedom + t * t), regularized=True)
        )

    low, high = 0.0, 1.0
    while tail(high) > error:
        low, high = high, 2 * high
    while high - low > 1e-10 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if tail(middle) > error else (low, middle)
    return high


def interval(differences: Sequence[float], error: float) -> Interval:
    """Student's interval of the mean; it misses the true mean with probability `error`.

    Differences without any spread give a point: they come from trainings that are the same to the last bit.
    """
    count = len(differences)
    if count < 2:
        mean = differences[0] if count else math.nan
        return Interval(mean, -math.inf, math.inf, count, math.nan)
    mean, deviation = fmean(differences), stdev(differences)
    half = student_quantile(error, count - 1) * deviation / math.sqrt(count)
    return Interval(mean, mean - half, mean + half, count, deviation)


def error_of_look(look: int, comparisons: int) -> float:
    """Share of `ERROR` that one comparison may spend at the look with this number, from 1.

    1 / (look (look + 1)) adds up to 1 over any number of looks, which nobody knows beforehand; Bonferroni's bound on
    looks and comparisons.
    """
    return ERROR / (look * (look + 1)) / comparisons


def cells_needed(deviation: float, half: float, error: float) -> int | None:
    """Least number of differences of this deviation whose interval is mean +- `half` or narrower.

    None: more than `MOST_CELLS`, or unknown.
    """

    def enough(count: int) -> bool:
        return student_quantile(error, count - 1) * deviation <= half * math.sqrt(count)

    if not (half > 0 and math.isfinite(deviation)) or not enough(MOST_CELLS):
        return None
    low, high = 1, MOST_CELLS
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


@dataclass(frozen=True)
class Spread:
    """Median, and the quantiles of 10 and 90 %."""

    median: float
    p10: float
    p90: float


def spread(values: Sequence[float]) -> Spread:
    """Return where most of some measured values lie."""
    p10, middle, p90 = np.quantile(values, (0.1, 0.5, 0.9)).tolist()
    return Spread(middle, p10, p90)
