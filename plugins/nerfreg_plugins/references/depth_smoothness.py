"""Exact values for `depth_smoothness_loss`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from mpmath import fsum, mpf

Patch = Sequence[Sequence[mpf]]


def depth_smoothness_loss(
    depth_patches: Sequence[Patch],
    visible: Sequence[Sequence[Sequence[bool]]],
    opacity: Sequence[Patch] | None = None,
) -> mpf:
    """Return the sum of squared depth differences of a patch, mean over patches.

    Args:
        depth_patches: `(P, S, S)`.
        visible: `(P, S, S)`; differences with a pixel that is not visible are left out.
        opacity: `(P, S, S)`, a factor of the differences that start at a pixel; 1 if None.
    """
    terms = []
    for index, (depth, seen) in enumerate(zip(depth_patches, visible, strict=True)):
        for (y, below), (x, right) in _starts(len(depth)):
            squares = [
                (depth[y][x] - depth[i][j]) ** 2
                for i, j in ((y, right), (below, x))
                if seen[y][x] and seen[i][j]
            ]
            terms.append(fsum(squares) * (1 if opacity is None else opacity[index][y][x]))
    return fsum(terms) / max(len(depth_patches), 1)


def _starts(side: int) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    return [(rows, columns) for rows in pairwise(range(side)) for columns in pairwise(range(side))]
