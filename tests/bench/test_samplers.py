from __future__ import annotations

import pytest
import torch
from torch import Tensor

from nerfreg.bench.media import Medium, Wall, cut, walls
from nerfreg.bench.samplers import (
    CELLS,
    SAMPLERS,
    Bundle,
    by_importance,
    inside,
    jittered,
    skipping,
    uniform,
)

SLAB = walls("slab", Wall(0.0, 1.0, 3.0))
# Six cells of the occupancy grid, found by the first look in any of them.
BLOCK = walls("block", Wall(64 / CELLS, 70 / CELLS, 500.0))


def bundle(medium: Medium, rays: int = 3) -> Bundle:
    return Bundle(medium, torch.zeros(rays), torch.ones(rays), torch.Generator().manual_seed(0))


def assert_tiled(t: Tensor, edges: Tensor) -> None:
    assert (edges[:, 0] == 0).all()
    assert (edges[:, -1] == 1).all()
    assert (edges[:, :-1] <= t).all()
    assert (t <= edges[:, 1:]).all()


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("count", [8, 64])
def test_samples_lie_in_intervals_that_tile_the_ray(sampler: str, count: int) -> None:
    sampled = SAMPLERS[sampler](bundle(BLOCK), count)
    assert sampled.t.shape == sampled.density.shape == (3, count)
    assert_tiled(sampled.t, sampled.t_edges)
    # Every sampler's density is the medium's: the block lies in occupied cells.
    torch.testing.assert_close(sampled.density, BLOCK.density(sampled.t))


def test_uniform_by_hand() -> None:
    sampled = uniform(bundle(SLAB), 4)
    assert sampled.t[0].tolist() == [0.125, 0.375, 0.625, 0.875]
    assert sampled.t_edges[0].tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert sampled.evaluations == 4


def test_jitter_differs_between_rays_and_stays_in_its_stratum() -> None:
    t = jittered(bundle(SLAB), 4).t
    assert (t[0] != t[1]).all()
    assert ((t * 4).long() == torch.arange(4)).all()


def test_importance_gathers_where_the_weights_are() -> None:
    # 16 coarse samples, one of them in the block: its interval, a sixteenth of the ray, gets nearly
    # all others.
    t = by_importance(bundle(BLOCK), 48).t
    inside = (t > 0.5 - 1 / 16) & (t < 0.5 + 1 / 8)
    assert inside.sum(dim=1).min() >= 32


def test_skipping_evaluates_occupied_cells_and_their_neighbours() -> None:
    # 6 of the grid's cells and one to either side, four samples to a cell.
    assert skipping(bundle(BLOCK), 4 * CELLS).evaluations == 4 * 8
    assert skipping(bundle(SLAB), 4 * CELLS).evaluations == 4 * CELLS


def test_skipping_may_lose_a_wall_thinner_than_a_cell() -> None:
    # Nine looks miss a sixth of a cell with probability (5/6)^9 = 0.19 (binomial spread over 400
    # rays: 0.02).
    thin = walls("thin", Wall(64.4 / CELLS, (64.4 + 1 / 6) / CELLS, 1e4))
    found = bundle(thin, 400).occupied.any(dim=1).float().mean()
    assert found.item() == pytest.approx(0.81, abs=0.08)


def test_inside_samples_windows_by_length() -> None:
    # Windows of 0.1 and 0.3: of 18 samples two are given, and 16 are divided into 4 and 12.
    medium = cut("gaps", SLAB, (0.2, 0.3), (0.5, 0.8))
    sampled = inside(bundle(medium), 18)
    assert sampled.t.shape == (3, 19) and sampled.evaluations == 18
    assert (sampled.t_edges[:, 0] == 0.2).all() and (sampled.t_edges[:, -1] == 0.8).all()
    solid = sampled.density > 0
    assert solid.sum(dim=1).tolist() == [18] * 3 and (~solid).nonzero()[:, 1].tolist() == [5] * 3
    lengths = sampled.t_edges.diff(dim=1)
    torch.testing.assert_close(lengths[:, 5], torch.full((3,), 0.2))
    torch.testing.assert_close((lengths * solid).sum(dim=1), torch.full((3,), 0.4))
