from __future__ import annotations

import pytest
import torch
from nerfreg_plugins.stereo.semi_global import JUMP, STEP, semi_global

DIRECTIONS = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0)]


def by_definition(cost):
    """Hirschmueller's recursion, pixel by pixel and plane by plane."""
    height, width, planes = cost.shape

    def path(y, x, d, dy, dx):
        own = float(cost[y, x, d])
        if not (0 <= y - dy < height and 0 <= x - dx < width):
            return own
        before = [path(y - dy, x - dx, other, dy, dx) for other in range(planes)]
        penalties = [0 if other == d else STEP if abs(other - d) == 1 else JUMP for other in range(planes)]
        cheapest = min(b + p for b, p in zip(before, penalties, strict=True))
        return own + cheapest - min(before)

    return [
        [[sum(path(y, x, d, dy, dx) for dy, dx in DIRECTIONS) for d in range(planes)] for x in range(width)]
        for y in range(height)
    ]


@pytest.mark.parametrize("size", [(3, 4, 3), (1, 5, 4), (4, 1, 2), (1, 1, 3)])
def test_against_the_definition(size):
    cost = torch.rand(size, generator=torch.Generator().manual_seed(0)) * 2
    torch.testing.assert_close(semi_global(cost), torch.tensor(by_definition(cost)), rtol=1e-5, atol=1e-5)


def test_the_cost_given_is_left_alone():
    cost = torch.rand(3, 3, 3, generator=torch.Generator().manual_seed(0))
    before = cost.clone()
    semi_global(cost)
    assert torch.equal(cost, before)


def test_neighbours_decide_where_a_pixel_knows_nothing():
    # All pixels match plane 2, but one, to which all planes are alike.
    cost = torch.full((5, 5, 4), 0.8)
    cost[..., 2] = 0.0
    cost[2, 2] = 0.4
    assert (semi_global(cost).argmin(-1) == 2).all()
