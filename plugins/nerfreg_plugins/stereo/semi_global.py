"""Semi-global matching (Hirschmueller 2008): smooth depth by eight directions of one-dimensional paths."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

STEP, JUMP = 0.05, 0.5
"""What it costs to go to the next plane, and to any other, where a match costs 0 to 2."""


def semi_global(cost: Float[Tensor, "height width planes"]) -> Float[Tensor, "height width planes"]:
    """For each pixel and plane: the cost of the cheapest paths that end there, summed over eight directions.

    A path L(p, d) = cost(p, d) + min(L(q, d), L(q, d +- 1) + STEP, min L(q, .) + JUMP) - min L(q, .), where q is the
    pixel before p; paths begin at the border of the image.
    """
    total = torch.zeros_like(cost)
    for slant in (-1, 0, 1):
        total += _downwards(cost, slant)
        total += _downwards(cost.flip(0), slant).flip(0)
    across = cost.transpose(0, 1).contiguous()
    total += _downwards(across, 0).transpose(0, 1)
    total += _downwards(across.flip(0), 0).flip(0).transpose(0, 1)
    return total


def _downwards(cost: Float[Tensor, "height width planes"], slant: int) -> Float[Tensor, "height width planes"]:
    """Paths from row to row that move `slant` columns to the right each time."""
    paths = cost.clone()
    for row in range(1, len(paths)):
        before = paths[row - 1].roll(slant, 0)
        least = before.amin(-1, keepdim=True)
        best = torch.minimum(before, least + JUMP)
        best[:, 1:] = torch.minimum(best[:, 1:], before[:, :-1] + STEP)
        best[:, :-1] = torch.minimum(best[:, :-1], before[:, 1:] + STEP)
        best -= least
        if slant:
            best[0 if slant > 0 else -1] = 0  # what rolled in from the other side of the image
        paths[row] += best
    return paths
