"""When and on what a run is scored."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from nerfreg.errors import NerfregError, require_range

FIRST_EVALUATION = 0.02
"""Share of the budget after which a run is scored for the first time."""


@dataclass
class EvalConfig:
    """How a run is scored.

    lpips: whether to compute LPIPS. lpips_weights: safetensors file with its weights; None looks for one.
    count: evaluations of a run, log-spaced over its budget; the last is at the end, on all test views at full size.
    at: shares of the budget at which to evaluate before the end, instead of the log-spaced ones.
    subset_size, pixels_stride: the evaluations before that take this many test views and every so-manieth pixel.
    save_renders: how many test views are saved as PNG at the end; None saves all.
    """

    lpips: bool = True
    lpips_weights: str | None = None
    count: int = 8
    at: list[float] | None = None
    subset_size: int = 2
    pixels_stride: int = 4
    save_renders: int | None = None

    def __post_init__(self) -> None:
        one = (1, math.inf)
        require_range(
            "eval", self, count=one, subset_size=one, pixels_stride=one, save_renders=(0, math.inf)
        )
        if self.at is not None and not all(0 < share <= 1 for share in self.at):
            raise NerfregError(
                f"eval.at={list(self.at)}: must be shares of the budget, above 0 and up to 1"
            )

    def times(self, seconds: float | None, steps: int | None) -> tuple[float, ...]:
        """Shares of a budget at which a run is scored, ascending, ending with 1."""
        if self.at is not None:
            return tuple(sorted({*self.at, 1.0}))
        return evaluation_times(seconds, steps, self.count)


def evaluation_times(seconds: float | None, steps: int | None, count: int) -> tuple[float, ...]:
    """Shares of the budget at which a run is scored: `count` of them, log-spaced from 0.02 to exactly 1.0, ascending.

    Where the budget is in steps alone, shares are rounded up to whole steps and duplicates dropped, so that
    `step / steps >= share` holds on the very step that was meant.
    """
    shares = [FIRST_EVALUATION ** (1 - i / (count - 1)) for i in range(count - 1)] + [1.0]
    if seconds is None and steps:
        shares = [min(steps, math.ceil(share * steps)) / steps for share in shares]
    return tuple(sorted(set(shares)))


def subset_of(views: Sequence[int], size: int) -> tuple[int, ...]:
    """`size` of the views, evenly spaced over their order and always the same; all of them where there are fewer."""
    if size >= len(views):
        return tuple(views)
    return tuple(views[(2 * i + 1) * len(views) // (2 * size)] for i in range(size))
