"""Exact values for `unseen_smoothness`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, pairwise

from mpmath import fsum, log, mpf


def unseen_smoothness_loss(
    depth_patches: Sequence[Sequence[Sequence[mpf]]],
    visible: Sequence[Sequence[Sequence[bool]]],
) -> mpf:
    """Return the sum of log(d / d')^2 over adjacent pixels of a patch, mean over patches.

    Args:
        depth_patches: `(P, S, S)`.
        visible: `(P, S, S)`; pairs with a pixel that is not visible are left out.
    """
    squares = []
    for depth, seen in zip(depth_patches, visible, strict=True):
        pixels = [list(zip(*rows, strict=True)) for rows in zip(depth, seen, strict=True)]
        for line in chain(pixels, zip(*pixels, strict=True)):
            for (d, is_seen), (other, other_seen) in pairwise(line):
                if is_seen and other_seen and d > 0 and other > 0:
                    squares.append(log(d / other) ** 2)
    return fsum(squares) / max(len(depth_patches), 1)
