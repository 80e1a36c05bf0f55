"""The Pareto front: what nothing else beats."""

from __future__ import annotations

import math
from collections.abc import Sequence


def front(costs: Sequence[tuple[float | None, float | None]]) -> list[int]:
    """Return the indices of the points that no other dominates, in the order of the first cost.

    Smaller is better in both costs. A point dominates another if it is nowhere worse and somewhere
    better, so that equal points are on the front together. A point with a cost that is unknown or
    not finite is not on it.
    """
    known = [
        (first, second, index)
        for index, (first, second) in enumerate(costs)
        if first is not None and second is not None and math.isfinite(first + second)
    ]
    chosen: list[tuple[float, float, int]] = []
    for point in sorted(known):
        if not chosen or point[1] < chosen[-1][1] or point[:2] == chosen[-1][:2]:
            chosen.append(point)
    return [index for *_, index in chosen]
