"""Run times that can be compared: one thread, warmed up, alternating, medians."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from time import perf_counter

import torch


@dataclass(frozen=True)
class RaySizes:
    """Samples per ray, ascending, rays at once, and repetitions of each measurement of time."""

    samples: tuple[int, ...]
    rays: int
    repetitions: int

    @property
    def conditions(self) -> str:
        """How times are measured, for the caption of a table."""
        return f"one thread; median of {self.repetitions} alternating repetitions after a warm-up"


def seconds_of(call: Callable[[], object]) -> float:
    """Return the run time of one call."""
    begun = perf_counter()
    call()
    return perf_counter() - begun


def in_turns(calls: Sequence[Callable[[], object]], rounds: int) -> list[list[float]]:
    """Return the seconds that each call takes in each round.

    In every round all are called once, one after the other, so that whatever else the machine
    does slows all of them down alike.
    """
    seconds: list[list[float]] = [[] for _ in calls]
    for _ in range(rounds):
        for call, measured in zip(calls, seconds, strict=True):
            measured.append(seconds_of(call))
    return seconds


def median_seconds(calls: Sequence[Callable[[], object]], repetitions: int) -> list[float]:
    """Return the median run time of each call, after one call of each to warm up."""
    with _quiet():
        in_turns(calls, 1)
        return [median(seconds) for seconds in in_turns(calls, repetitions)]


@contextmanager
def _quiet() -> Iterator[None]:
    # One thread, and no garbage collection in the middle of a measurement.
    threads, collecting = torch.get_num_threads(), gc.isenabled()
    torch.set_num_threads(1)
    gc.disable()
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        if collecting:
            gc.enable()
