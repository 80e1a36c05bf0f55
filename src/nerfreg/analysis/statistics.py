"""Intervals for means of a few differences, and how many differences an interval takes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from statistics import fmean, stdev

import mpmath
import numpy as np

ERROR = 0.05
"""The probability, at most, that any verdict of a study is wrong."""

MOST_CELLS = 4096


@dataclass(frozen=True)
class Interval:
    """The mean of a few differences, and the ends between which the true mean probably lies.

    Attributes:
        mean: Of the differences; nan if there is none.
        low: The lower end; infinite for fewer than two, which say nothing about their spread.
        high: The upper end, likewise.
        count: How many differences there are.
        deviation: Their standard deviation; nan for fewer than two.
    """

    mean: float
    low: float
    high: float
    count: int
    deviation: float

    def inside(self, limit: float) -> bool:
        """Return whether the whole interval lies in [-limit, limit]."""
        return -limit <= self.low and self.high <= limit


@cache
def student_quantile(error: float, freedom: int) -> float:
    """Return t with P(|T| > t) = error for Student's t with `freedom` degrees of freedom.

    P(|T| > t) is the regularized incomplete beta function I_x(freedom / 2, 1 / 2) at
    x = freedom / (freedom + t^2).
    """

    def tail(t: float) -> float:
        x = freedom / (freedom + t * t)
        return float(mpmath.betainc(freedom / 2, 0.5, 0, x, regularized=True))

    low, high = 0.0, 1.0
    while tail(high) > error:
        low, high = high, 2 * high
    while high - low > 1e-10 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if tail(middle) > error else (low, middle)
    return high


def interval(differences: Sequence[float], error: float) -> Interval:
    """Return Student's interval, which misses the true mean with probability `error`."""
    count = len(differences)
    if count < 2:
        mean = differences[0] if count else math.nan
        return Interval(mean, -math.inf, math.inf, count, math.nan)
    # Without any spread this is a point: such trainings are the same to the last bit.
    mean, deviation = fmean(differences), stdev(differences)
    half = student_quantile(error, count - 1) * deviation / math.sqrt(count)
    return Interval(mean, mean - half, mean + half, count, deviation)


def error_of_look(look: int, comparisons: int) -> float:
    """Return the share of `ERROR` that one comparison may spend at this look, counted from 1.

    By Bonferroni's bound the shares of all looks and comparisons add up. Nobody knows beforehand
    how many looks there will be, and 1 / (look (look + 1)) adds up to 1 over any number of them.
    """
    return ERROR / (look * (look + 1)) / comparisons


def cells_needed(deviation: float, half: float, error: float) -> int | None:
    """Return how many differences of this deviation give an interval of mean +- `half`.

    None stands for more than `MOST_CELLS`, or for unknown.
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
