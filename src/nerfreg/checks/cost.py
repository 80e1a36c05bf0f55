"""Checks of how work and memory of a step grow with the number of rays and of samples."""

from __future__ import annotations

import math
import time
import tracemalloc
from collections.abc import Sequence
from functools import cache
from typing import Any

from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from nerfreg.checks.driver import Driver
from nerfreg.checks.inputs import Inputs
from nerfreg.checks.report import Report
from nerfreg.checks.steps import RunCase, play, small_inputs
from nerfreg.checks.subject import Subject
from nerfreg.registry import Hooks

COST_CASE = RunCase("cost", "a step with N, 2 N and 4 N samples, and with R, 2 R and 4 R rays")

SAMPLES = (48, 96, 192)
FEW = 8
RAYS = (16, 32, 64)
"""How many times the rays of a case, with `FEW` samples each, are repeated."""

TIMED = {"samples": (256, 512, 1024), "rays": (32, 64, 128)}
"""The same where time is measured: enough to take longer than all that does not grow."""

EXPONENT = 1.5
"""Growth beyond which a cost counts as quadratic: that of sorting is hardly more than 1."""

SMALL, SLOW = 1e5, 0.1
"""Growth in bytes and in seconds that does not matter, whatever it is."""

PLAIN = 8
"""Ratio of the times of four times as many that is plainly more than linear."""

REPEATS = 3


class Traffic(TorchDispatchMode):
    """Counts the bytes that torch's operations read and write, forward and backward.

    Attributes:
        bytes: How many so far.
    """

    def __init__(self) -> None:
        # PyTorch leaves it without types.
        begin: Any = super().__init__
        begin()
        self.bytes = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        given = [x for x in tree_leaves((args, kwargs)) if isinstance(x, Tensor)]
        made = [x for x in tree_leaves(result) if isinstance(x, Tensor)]
        old = {x.untyped_storage()._cdata for x in given}
        # A view reads and writes nothing.
        if func._schema.is_mutable or any(x.untyped_storage()._cdata not in old for x in made):
            self.bytes += sum(x.numel() * x.element_size() for x in (*given, *made))
        return result


def check_cost(report: Report, case: RunCase, _: None) -> None:
    """Check that twice the samples, or twice the rays, do not cost four times as much."""
    for what, sizes in (("samples", SAMPLES), ("rays", RAYS)):
        found = [_step_cost(Driver(report.subject, _inputs(what, size))) for size in sizes]
        vanilla = [_vanilla(what, size) for size in sizes]
        traffic, memory = (
            [own - without for own, without in zip(column, others, strict=True)]
            for column, others in zip(
                zip(*found, strict=True), zip(*vanilla, strict=True), strict=True
            )
        )
        wrong = wrong_growth(what, traffic, "need {:.1f} times the memory traffic", SMALL)
        wrong = wrong or wrong_growth(what, memory, "need {:.1f} times the memory", SMALL)
        # Loops of Python show in nothing but time.
        report.judge("cost", wrong or _wrong_times(report.subject, what))


def wrong_growth(what: str, costs: Sequence[float], words: str, least: float) -> list[str]:
    """Return a line if a cost grows with the square of a number.

    Differences between three sizes, each twice the one before, leave out what is constant: they
    grow by a factor of 2 if the rest is linear, and of 4 if it is quadratic.

    Args:
        what: "samples" or "rays", of which there are more and more.
        costs: At each size.
        words: What a ratio of costs means.
        least: Growth that does not matter.
    """
    first, second, third = costs
    grown = third - second
    if grown <= least or grown <= 2**EXPONENT * (second - first):
        return []
    letter = {"samples": "N", "rays": "R"}[what]
    ratio = words.format(third / max(first, 1e-9))
    return [f"cost grows with {letter}^2: four times as many {what} {ratio}"]


def _wrong_times(subject: Subject, what: str) -> list[str]:
    sizes, times = TIMED[what], list[float]()
    for size in reversed(sizes):
        times.insert(0, _seconds(Driver(subject, _inputs(what, size))))
        # The largest comes first: if it takes no time, nothing can have grown.
        if times[-1] < SLOW:
            return []
    if times[-1] < PLAIN * times[0]:
        return []
    return wrong_growth(what, times, "take {:.1f} times as long", SLOW)


def _seconds(driver: Driver) -> float:
    """The best time of a few steps, which other processes have disturbed least."""
    best = math.inf
    for index in range(REPEATS):
        start = time.process_time()
        play(driver, driver.step_at(index, 100))
        best = min(best, time.process_time() - start)
        if best < SLOW:
            break
    return best


def _inputs(what: str, size: int) -> Inputs:
    return small_inputs(size) if what == "samples" else small_inputs(FEW).repeated(size)


@cache
def _vanilla(what: str, size: int) -> tuple[float, float]:
    """What a step without a plugin costs."""
    return _step_cost(Driver(Subject.none(), _inputs(what, size), Hooks()))


def _step_cost(driver: Driver) -> tuple[float, float]:
    """Bytes that torch reads and writes in a step, and bytes that numpy needs at most."""
    # What a plugin makes once and keeps is no cost of a step, but reading it in each step is.
    play(driver, driver.step_at(0, 100))
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        with Traffic() as traffic:
            play(driver, driver.step_at(1, 100))
        return float(traffic.bytes), float(tracemalloc.get_traced_memory()[1] - before)
    finally:
        tracemalloc.stop()
