"""Both traversals of a grid against each other, and against asking at many points."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from nerfreg.hooks import OccupancyGrid
from nerfreg.rays.traversal import (
    CHUNK,
    Runs,
    occupied_runs,
    occupied_runs_plain,
    runs_of_parts,
)
from nerfreg.rays.traversal_numba import ROOM

BOTH = pytest.mark.parametrize("follow", [occupied_runs, occupied_runs_plain])
LOW = torch.tensor([-1.1, -0.7, 0.2])


def some_grid(shape: tuple[int, int, int], share: float, seed: int = 0) -> OccupancyGrid:
    generator = torch.Generator().manual_seed(seed)
    occupied = torch.rand(shape, generator=generator) < share
    # A part of it is full and a part empty, by whole blocks.
    occupied[: shape[0] // 2, : shape[1] // 2] = True
    occupied[shape[0] // 2 :, : shape[1] // 2] = False
    return OccupancyGrid(occupied, LOW, 0.093)


def some_rays(grid: OccupancyGrid, count: int, seed: int = 1) -> tuple[Tensor, ...]:
    """Rays that begin inside and outside of a grid, and end before, in and behind it."""
    generator = torch.Generator().manual_seed(seed)
    size = torch.tensor(grid.occupied.shape) * grid.cell
    origins = grid.low + size * (2 * torch.rand(count, 3, generator=generator) - 0.5)
    directions = functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
    near = torch.rand(count, generator=generator)
    lengths = 0.05 + 4 * torch.rand(count, generator=generator) ** 2
    return origins, directions, near, near + lengths


def inside(runs: Runs, t: Tensor) -> Tensor:
    """Whether each distance (R, T) lies in one of the runs of its ray."""
    within = torch.zeros_like(t, dtype=torch.long)
    hit = (t[runs.ray] >= runs.enter[:, None]) & (t[runs.ray] < runs.leave[:, None])
    return within.index_add(0, runs.ray, hit.long()) > 0


def check_form(runs: Runs) -> None:
    """Runs have a length, ascend, and do not touch those of the same ray."""
    assert (runs.leave > runs.enter).all() and (runs.ray.diff() >= 0).all()
    same = runs.ray.diff() == 0
    assert (runs.enter[1:] > runs.leave[:-1])[same].all()


SHAPES = [(8, 8, 8), (16, 8, 24), (13, 21, 9), (1, 1, 1), (3, 1, 30), (7, 40, 17)]


@pytest.mark.parametrize("share", [0.05, 0.5, 0.95])
@pytest.mark.parametrize("shape", SHAPES)
def test_both_find_the_same(shape: tuple[int, int, int], share: float) -> None:
    grid = some_grid(shape, share)
    rays = some_rays(grid, 400)
    compiled, plain = occupied_runs(grid, *rays), occupied_runs_plain(grid, *rays)
    check_form(compiled)
    check_form(plain)
    # Corners and edges of cells are cut by rounding in either way, by parts that are as short.
    long = [runs.leave - runs.enter > 1e-5 for runs in (compiled, plain)]
    lengths = [
        torch.zeros(400).index_add(0, runs.ray, runs.leave - runs.enter)
        for runs in (compiled, plain)
    ]
    torch.testing.assert_close(*lengths, rtol=0, atol=1e-5)
    for left, right in zip(compiled, plain, strict=True):
        torch.testing.assert_close(left[long[0]], right[long[1]], rtol=0, atol=1e-5)


@BOTH
@pytest.mark.parametrize("shape", SHAPES)
def test_runs_are_where_the_cells_are_occupied(shape: tuple[int, int, int], follow) -> None:
    grid = some_grid(shape, 0.5)
    origins, directions, near, far = some_rays(grid, 200)
    runs = follow(grid, origins, directions, near, far)
    share = (torch.arange(1000) + 0.5) / 1000
    t = torch.lerp(near[:, None], far[:, None], share)
    positions = origins[:, None] + directions[:, None] * t[..., None]
    expected = grid.contains(positions.view(-1, 3)).view(t.shape)
    # Away from the planes between cells, where rounding decides.
    unit = (positions - grid.low) / grid.cell
    clear = ((unit - unit.round()).abs() > 1e-4).all(dim=-1)
    assert clear.float().mean() > 0.99
    assert torch.equal(inside(runs, t)[clear], expected[clear])
    # Nothing before the beginning and behind the end.
    assert (runs.enter >= near[runs.ray]).all() and (runs.leave <= far[runs.ray]).all()


@BOTH
def test_a_ray_along_an_axis_through_known_cells(follow) -> None:
    # Cells 1, 2 and 5 of eight along x, of length 1/2 from -1 on: [-0.5, 0.5] and [1.5, 2].
    occupied = torch.zeros(8, 1, 1, dtype=torch.bool)
    occupied[[1, 2, 5]] = True
    grid = OccupancyGrid(occupied, torch.tensor([-1.0, 0.0, 0.0]), 0.5)
    origins = torch.tensor([[-3.0, 0.25, 0.25], [4.0, 0.25, 0.25], [0.0, 0.25, 0.25]])
    directions = torch.tensor([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    runs = follow(grid, origins, directions, torch.zeros(3), torch.tensor([9.0, 9.0, 1.75]))
    assert runs.ray.tolist() == [0, 0, 1, 1, 2, 2]
    # From x = -3; from x = 4 backwards; from x = 0, in a cell, to x = 1.75, in another.
    assert runs.enter.tolist() == [2.5, 4.5, 2.0, 3.5, 0.0, 1.5]
    assert runs.leave.tolist() == [3.5, 5.0, 2.5, 4.5, 0.5, 1.75]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rays_along_axes_and_in_planes_between_cells(axis: int, sign: float) -> None:
    grid = OccupancyGrid(some_grid((16, 11, 9), 0.5).occupied, torch.zeros(3), 0.25)
    # Origins on the planes between cells exactly, and off them.
    offsets = torch.tensor([0.0, 0.25, 0.3, 1.0, 2.0, 2.125])
    first, second = torch.meshgrid(offsets, offsets, indexing="ij")
    origins = torch.zeros(36, 3)
    origins[:, axis] = -sign * 5
    origins[:, (axis + 1) % 3], origins[:, (axis + 2) % 3] = first.flatten(), second.flatten()
    directions = torch.zeros(36, 3)
    directions[:, axis] = sign
    bounds = torch.zeros(36), torch.full((36,), 12.0)
    compiled, plain = (
        follow(grid, origins, directions, *bounds)
        for follow in (occupied_runs, occupied_runs_plain)
    )
    assert torch.equal(compiled.ray, plain.ray)
    torch.testing.assert_close(compiled.enter, plain.enter)
    torch.testing.assert_close(compiled.leave, plain.leave)
    t = (torch.arange(1, 240) * 0.05 + 1e-3).expand(36, -1)
    positions = origins[:, None] + directions[:, None] * t[..., None]
    assert torch.equal(inside(compiled, t), grid.contains(positions.reshape(-1, 3)).view(t.shape))


@BOTH
def test_diagonals_through_corners_of_cells(follow) -> None:
    # Cells of a checkerboard: the diagonal goes through cells (i, i, i) alone, and these alternate.
    x, y, z = torch.meshgrid(*[torch.arange(9)] * 3, indexing="ij")
    board = (x + y + z) % 2 == 0
    grid = OccupancyGrid(board, torch.zeros(3), 1.0)
    diagonal = torch.full((1, 3), 1 / math.sqrt(3))
    runs = follow(grid, -diagonal, diagonal, torch.zeros(1), torch.tensor([100.0]))
    total = (runs.leave - runs.enter).sum().item()
    # Cells (0, 0, 0), (2, 2, 2) to (8, 8, 8) count, and the four between them do not. The first and
    # the last reach to the ends, as the nearest cells of what lies outside of the grid.
    assert total == pytest.approx(100 - 4 * math.sqrt(3), rel=1e-5)


@BOTH
@pytest.mark.parametrize("occupied", [True, False])
def test_a_grid_that_is_all_alike(follow, occupied: bool) -> None:
    grid = OccupancyGrid(torch.full((20, 9, 17), occupied), LOW, 0.1)
    rays = some_rays(grid, 50)
    runs = follow(grid, *rays)
    if occupied:
        assert torch.equal(runs.ray, torch.arange(50))
        assert torch.equal(runs.enter, rays[2]) and torch.equal(runs.leave, rays[3])
    else:
        assert len(runs.ray) == len(runs.enter) == len(runs.leave) == 0


@BOTH
def test_outside_of_the_grid_the_nearest_cell_counts(follow) -> None:
    occupied = torch.zeros(4, 4, 4, dtype=torch.bool)
    occupied[3, 0, 0] = True
    grid = OccupancyGrid(occupied, torch.zeros(3), 1.0)
    # Beside the grid along x, nearest to the row (x, 0, 0); leaves it and never returns.
    origins, ahead = torch.tensor([[-2.0, -1.0, -5.0]]), torch.tensor([[1.0, 0.0, 0.0]])
    runs = follow(grid, origins, ahead, torch.zeros(1), torch.tensor([50.0]))
    assert (runs.enter.tolist(), runs.leave.tolist()) == ([5.0], [50.0])


@BOTH
def test_rays_without_length_have_no_runs(follow) -> None:
    grid = OccupancyGrid(torch.ones(4, 4, 4, dtype=torch.bool), torch.zeros(3), 1.0)
    origins, ahead = torch.ones(3, 3), torch.tensor([[1.0, 0.0, 0.0]]).repeat(3, 1)
    runs = follow(
        grid, origins, ahead, torch.tensor([1.0, 1.0, 2.0]), torch.tensor([1.0, 2.0, 1.0])
    )
    assert runs.ray.tolist() == [1]
    none = follow(grid, origins[:0], ahead[:0], torch.zeros(0), torch.zeros(0))
    assert len(none.ray) == 0 and none.ray.dtype == torch.long


def test_a_ray_of_more_runs_than_there_is_room_for_at_first() -> None:
    occupied = torch.zeros(4 * ROOM, 1, 1, dtype=torch.bool)
    occupied[::2] = True
    grid = OccupancyGrid(occupied, torch.zeros(3), 1.0)
    origins = torch.tensor([[-1.0, 0.5, 0.5], [8.5, 0.5, 0.5]])
    ahead = torch.tensor([[1.0, 0.0, 0.0]]).repeat(2, 1)
    far = torch.tensor([4.0 * ROOM, 1.0])
    runs = occupied_runs(grid, origins, ahead, torch.zeros(2), far)
    assert torch.bincount(runs.ray).tolist() == [2 * ROOM, 1]
    # Cell 2 i begins at 2 i + 1, since the ray begins at -1; cell 0 is the nearest before that.
    starts = 2 * torch.arange(2.0 * ROOM) + 1
    assert torch.equal(runs.enter[:-1], starts.where(starts > 1, torch.tensor(0.0)))
    assert torch.equal(runs.leave[:-1], (starts + 1).clamp_max(4.0 * ROOM))


def test_the_plain_one_takes_many_rays_in_chunks() -> None:
    grid = some_grid((5, 4, 3), 0.5)
    rays = some_rays(grid, CHUNK + 10)
    compiled, plain = occupied_runs(grid, *rays), occupied_runs_plain(grid, *rays)
    long = [runs.leave - runs.enter > 1e-5 for runs in (compiled, plain)]
    assert torch.equal(compiled.ray[long[0]], plain.ray[long[1]])
    assert int(plain.ray.max()) >= CHUNK


def test_gaps_that_single_precision_does_not_see_are_none() -> None:
    # Distances around 1e6 are multiples of 1/16, of which the empty cell is a sixtieth.
    occupied = torch.tensor([True, False, True])[:, None, None]
    grid = OccupancyGrid(occupied, torch.tensor([-1e-3, 0.0, 0.0]), 1e-3)
    origins, ahead = torch.tensor([[-1e6, 0.0, 0.0]]), torch.tensor([[1.0, 0.0, 0.0]])
    bounds = torch.tensor([1e6 - 100]), torch.tensor([1e6 + 100])
    for follow in (occupied_runs, occupied_runs_plain):
        runs = follow(grid, origins, ahead, *bounds)
        assert (runs.enter.tolist(), runs.leave.tolist()) == ([1e6 - 100], [1e6 + 100])


def test_parts_are_joined_across_those_without_length() -> None:
    borders = torch.tensor([[0.0, 1.0, 1.0, 2.0, 3.0, 3.0, 4.0]])
    counts = torch.tensor([[True, False, True, False, True, True]])
    runs = runs_of_parts(borders, counts)
    # [0, 1] and [1, 2] touch, [2, 3] is outside, [3, 4] follows what has no length.
    assert (runs.enter.tolist(), runs.leave.tolist()) == ([0.0, 3.0], [2.0, 4.0])
    assert runs.ray.tolist() == [0, 0]


def test_double_precision_stays_what_it_is() -> None:
    grid = some_grid((9, 9, 9), 0.5)
    rays = [part.double() for part in some_rays(grid, 20)]
    for follow in (occupied_runs, occupied_runs_plain):
        assert follow(grid, *rays).enter.dtype == torch.float64
