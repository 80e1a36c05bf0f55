"""Cells of a grid, and its blocks."""

from __future__ import annotations

import pytest
import torch

from nerfreg.hooks import OccupancyGrid
from nerfreg.hooks.occupancy import BLOCK, EMPTY, FULL, MIXED


def test_cells_over_a_cube() -> None:
    grid = OccupancyGrid.over(torch.tensor([1.0, 2.0, 3.0]), 2.0, torch.ones(8, 8, 8) > 0)
    assert grid.cell == 0.5 and grid.low.tolist() == [-1.0, 0.0, 1.0]
    assert grid.centers.shape == (8, 8, 8, 3)
    assert grid.centers[0, 0, 0].tolist() == [-0.75, 0.25, 1.25]
    assert grid.centers[7, 1, 2].tolist() == [2.75, 0.75, 2.25]


def test_each_centre_lies_in_its_own_cell() -> None:
    occupied = torch.rand(5, 6, 7, generator=torch.Generator().manual_seed(0)) < 0.5
    grid = OccupancyGrid(occupied, torch.tensor([-0.3, 10.0, 2.0]), 0.7)
    assert torch.equal(grid.contains(grid.centers.view(-1, 3)).view(5, 6, 7), occupied)


def test_outside_the_nearest_cell_counts() -> None:
    occupied = torch.zeros(3, 3, 3, dtype=torch.bool)
    occupied[0, 2, 1] = True
    grid = OccupancyGrid(occupied, torch.zeros(3), 1.0)
    # Just before the first plane, where rounding towards zero would reach the cell anyway, and far.
    at = torch.tensor([[-0.5, 2.5, 1.5], [-9.0, 2.5, 1.5], [-9.0, 99.0, 1.5], [-9.0, 99.0, 99.0]])
    assert grid.contains(at).tolist() == [True, True, True, False]


@pytest.mark.parametrize("shape", [(8, 16, 24), (9, 15, 1), (1, 1, 1), (17, 3, 8)])
def test_blocks_tell_what_their_cells_are(shape: tuple[int, int, int]) -> None:
    generator = torch.Generator().manual_seed(0)
    occupied = torch.rand(shape, generator=generator) < 0.5
    occupied[:8, :8, :8] = True
    occupied[8:16] = False
    blocks = OccupancyGrid(occupied, torch.zeros(3), 1.0).blocks
    assert blocks.shape == tuple(-(-n // BLOCK) for n in shape)
    for index in torch.cartesian_prod(*[torch.arange(n) for n in blocks.shape]).view(-1, 3):
        x, y, z = (slice(BLOCK * int(i), BLOCK * int(i) + BLOCK) for i in index)
        cells = occupied[x, y, z]
        expected = FULL if cells.all() else MIXED if cells.any() else EMPTY
        assert blocks[tuple(index)] == expected


def test_a_grid_is_copied_to_a_device_once() -> None:
    grid = OccupancyGrid(torch.ones(2, 3, 4, dtype=torch.bool), torch.zeros(3), 1.0)
    assert grid.to(torch.device("cpu")) is grid
    copy = grid.to(torch.device("meta"))
    assert copy.occupied.device == copy.low.device == torch.device("meta")
    assert (copy.occupied.shape, copy.cell) == ((2, 3, 4), 1.0)
    assert grid.to(torch.device("meta")) is copy
