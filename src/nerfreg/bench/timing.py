"""Run times that can be compared: one thread, warmed up, alternating, medians."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from time import perf_counter

import numpy as np
import torch

CONDITIONS = "one thread; median of {repetitions} alternating repetitions after a warm-up"
"""What the caption of every table of run times says."""


def median_seconds(calls: Sequence[Callable[[], object]], repetitions: int) -> list[float]:
    """The median run time of each call, in seconds.

    Each is called once to warm up; then all take turns, so that whatever else the machine does falls on all alike.
    """
    with _quiet():
        for call in calls:
            call()
        return [median(seconds) for seconds in in_turns(calls, repetitions)]


def in_turns(calls: Sequence[Callable[[], object]], rounds: int) -> list[list[float]]:
    """The run times of each call, in seconds: in every round all are called once, one after the other."""
    seconds: list[list[float]] = [[] for _ in calls]
    for _ in range(rounds):
        for call, measured in zip(calls, seconds, strict=True):
            begun = perf_counter()
            call()
            measured.append(perf_counter() - begun)
    return seconds


@dataclass(frozen=True)
class Spread:
    """Median, and the quantiles of 10 and 90 %."""

    median: float
    p10: float
    p90: float


def spread(values: Sequence[float]) -> Spread:
    """Where most of some measured values lie."""
    p10, middle, p90 = np.quantile(values, (0.1, 0.5, 0.9)).tolist()
    return Spread(middle, p10, p90)


@contextmanager
def _quiet() -> Iterator[None]:
    """One thread, and no garbage collection in the middle of a measurement."""
    threads, collecting = torch.get_num_threads(), gc.isenabled()
    torch.set_num_threads(1)
    gc.disable()
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        if collecting:
            gc.enable()
