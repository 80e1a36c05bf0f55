"""Run times that can be compared: one thread, warmed up, alternating, medians."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from statistics import median
from time import perf_counter

import torch

CONDITIONS = "one thread; median of {repetitions} alternating repetitions after a warm-up"
"""What the caption of every table of run times says."""


def median_seconds(calls: Sequence[Callable[[], object]], repetitions: int) -> list[float]:
    """The median run time of each call, in seconds.

    Each is called once to warm up; then all take turns, so that whatever else the machine does falls on all alike.
    """
    seconds: list[list[float]] = [[] for _ in calls]
    with _quiet():
        for call in calls:
            call()
        for _ in range(repetitions):
            for call, measured in zip(calls, seconds, strict=True):
                begun = perf_counter()
                call()
                measured.append(perf_counter() - begun)
    return [median(measured) for measured in seconds]


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
