"""When a run is scored, and on which views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from nerfreg.errors import NerfregError, require_range

FIRST_EVALUATION = 0.02
"""Share of the budget after which a run is first scored."""


@dataclass
class EvalConfig:
    """How a run is scored.

    Attributes:
        lpips: Whether to compute LPIPS.
        lpips_weights: A safetensors file with the weights of LPIPS; None looks for one.
        count: Number of evaluations, log-spaced over the budget. The last one is at the end, on all
            test views at full size.
        at: Shares of the budget at which to evaluate before the end, instead of log-spaced ones.
        subset_size: Number of test views that evaluations before the end use.
        pixels_stride: Stride between the rows and columns that evaluations before the end use.
        save_renders: Number of test views that are saved as PNG at the end; None saves all.
    """

    lpips: bool = True
    lpips_weights: str | None = None
    count: int = 8
    at: list[float] | None = None
    subset_size: int = 2
    pixels_stride: int = 4
    save_renders: int | None = None

    def __post_init__(self) -> None:
        """Raise NerfregError for values out of range."""
        one = (1, math.inf)
        require_range(
            "eval", self, count=one, subset_size=one, pixels_stride=one, save_renders=(0, math.inf)
        )
        if self.at is not None and not all(0 < share <= 1 for share in self.at):
            raise NerfregError(
                f"eval.at={list(self.at)}: must be shares of the budget, above 0 and at most 1"
            )

    def times(self, seconds: float | None, steps: int | None) -> tuple[float, ...]:
        """Return the shares of a budget at which a run is scored.

        Args:
            seconds: The budget in seconds, if it is limited in time.
            steps: The budget in steps, if it is limited in steps.

        Returns:
            The shares, ascending, ending with 1.
        """
        if self.at is not None:
            return tuple(sorted({*self.at, 1.0}))
        return evaluation_times(seconds, steps, self.count)


def evaluation_times(seconds: float | None, steps: int | None, count: int) -> tuple[float, ...]:
    """Space evaluations logarithmically over a budget.

    Args:
        seconds: The budget in seconds, if it is limited in time.
        steps: The budget in steps, if it is limited in steps.
        count: Number of evaluations.

    Returns:
        Shares of the budget from `FIRST_EVALUATION` to 1, ascending. There are fewer than `count`
        if steps are so few that some would coincide.
    """
    # The last share is not computed: for a single evaluation the formula would divide by zero.
    shares = [FIRST_EVALUATION ** (1 - i / (count - 1)) for i in range(count - 1)] + [1.0]
    # Shares of whole steps, by the same division with which the trainer computes its share: then
    # `step / steps >= share` becomes true on the very step that is meant.
    if seconds is None and steps:
        shares = [min(steps, math.ceil(share * steps)) / steps for share in shares]
    return tuple(sorted(set(shares)))


def subset_of(views: Sequence[int], size: int) -> tuple[int, ...]:
    """Choose evenly spaced views, always the same ones.

    Args:
        views: The views to choose from.
        size: How many to choose.

    Returns:
        The middle views of `size` equal sections of the list, or all views if there are no more.
    """
    if size >= len(views):
        return tuple(views)
    return tuple(views[(2 * i + 1) * len(views) // (2 * size)] for i in range(size))
