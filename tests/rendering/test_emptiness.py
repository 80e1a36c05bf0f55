"""Which parts of rays are sampled where plugins declare space empty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from nerfreg import Regularizer, hookimpl
from nerfreg.hooks import OccupancyGrid, Rays
from nerfreg.rays.traversal import occupied_runs
from nerfreg.registry import Hooks
from nerfreg.rendering.emptiness import PROBES, sampled_runs


@dataclass
class Cells(Regularizer):
    """A grid of cells, or none."""

    grid: Any = None

    @hookimpl
    def nerfreg_occupancy(self):
        return self.grid


@dataclass
class Function(Regularizer):
    """Empty is where a function says so; None: the plugin says nothing."""

    where: Any = None

    @hookimpl
    def nerfreg_empty(self, positions):
        return None if self.where is None else self.where(positions)


def some_rays(count: int = 50) -> Rays:
    generator = torch.Generator().manual_seed(0)
    origins = torch.tensor([0.0, 0.0, 3.0]) + 0.2 * torch.randn(count, 3, generator=generator)
    ahead = torch.tensor([0.0, 0.0, -1.0]) + 0.2 * torch.randn(count, 3, generator=generator)
    near, far = torch.full((count,), 1.5), torch.full((count,), 4.5)
    return Rays(origins, functional.normalize(ahead, dim=1), near, far, torch.zeros(count, 3))


def a_grid(share: float = 0.3, cells: int = 6, seed: int = 0) -> OccupancyGrid:
    generator = torch.Generator().manual_seed(seed)
    occupied = torch.rand((cells,) * 3, generator=generator) < share
    return OccupancyGrid.over(torch.zeros(3), 1.0, occupied)


def covered(runs: Any, rays: Rays, count: int = 2000) -> tuple[Tensor, Tensor]:
    """Distances (R, T) all along rays, and which of them lie in runs."""
    share = (torch.arange(count) + 0.5) / count
    t = torch.lerp(rays.near[:, None], rays.far[:, None], share)
    hit = (t[runs.ray] >= runs.enter[:, None]) & (t[runs.ray] <= runs.leave[:, None])
    return t, torch.zeros_like(t).index_add(0, runs.ray, hit.float()) > 0


def points(rays: Rays, t: Tensor) -> Tensor:
    return rays.origins[:, None] + rays.directions[:, None] * t[..., None]


def test_nothing_declared_is_no_runs(step) -> None:
    rays = some_rays()
    bounds = rays.near, rays.far
    assert sampled_runs(Hooks(), rays, *bounds, step(index=0)) is None
    # Nor where a plugin could, and does not in this step.
    silent = Hooks({"cells": Cells(), "function": Function()})
    assert sampled_runs(silent, rays, *bounds, step(index=0)) is None


def test_a_single_grid_is_followed_exactly(step) -> None:
    rays, grid = some_rays(), a_grid()
    found = sampled_runs(Hooks({"cells": Cells(grid=grid)}), rays, rays.near, rays.far, step(0))
    expected = occupied_runs(grid, rays.origins, rays.directions, rays.near, rays.far)
    assert found is not None and len(found.ray) > 50
    for ours, theirs in zip(found, expected, strict=True):
        assert torch.equal(ours, theirs)


def test_a_plugin_that_is_silent_does_not_change_the_grid_of_another(step) -> None:
    rays, grid = some_rays(), a_grid()
    hooks = Hooks({"cells": Cells(grid=grid), "silent": Cells()})
    found = sampled_runs(hooks, rays, rays.near, rays.far, step(0))
    expected = occupied_runs(grid, rays.origins, rays.directions, rays.near, rays.far)
    assert found is not None and torch.equal(found.enter, expected.enter)


def test_a_function_is_asked_along_the_ray_and_covers_what_is_not_empty(step) -> None:
    rays, grid = some_rays(), a_grid()
    hooks = Hooks({"same": Function(where=lambda at: ~grid.contains(at))})
    found = sampled_runs(hooks, rays, rays.near, rays.far, step(0))
    assert found is not None
    t, inside = covered(found, rays)
    full = grid.contains(points(rays, t).view(-1, 3)).view(t.shape)
    # Parts of 3/128 are shorter than most of what rays cut of cells of 1/3; corners may be missed.
    probe = 3.0 / PROBES
    assert (full & ~inside).float().mean() < 2e-3
    # What is sampled in vain lies within two parts of something, or of a border of its part.
    near = functional.max_pool1d(full.float(), 2 * int(2 * probe / (3.0 / 2000)) + 1, 1, 31)
    assert not (inside & (near[:, : t.shape[1]] == 0)).any()
    assert inside.float().mean() < full.float().mean() + 0.1


def test_space_is_empty_if_any_of_several_says_so(step) -> None:
    rays = some_rays()
    first, second = a_grid(0.6), a_grid(0.6, 5, 1)
    hooks = Hooks(
        {
            "first": Cells(grid=first),
            "second": Cells(grid=second),
            "half": Function(where=lambda at: at[:, 0] < 0),
        }
    )
    found = sampled_runs(hooks, rays, rays.near, rays.far, step(0))
    assert found is not None
    t, inside = covered(found, rays)
    at = points(rays, t).view(-1, 3)
    full = (first.contains(at) & second.contains(at) & (at[:, 0] >= 0)).view(t.shape)
    assert (full & ~inside).float().mean() < 2e-3 < inside.float().mean() < 0.6
    empty = hooks.empty(at, step(0))
    assert empty is not None and torch.equal(~empty.view(t.shape), full)


def test_rays_without_length_have_no_runs(step) -> None:
    rays = some_rays(3)
    hooks = Hooks({"none": Function(where=lambda at: torch.zeros(len(at), dtype=torch.bool))})
    near, far = torch.tensor([1.0, 2.0, 2.0]), torch.tensor([3.0, 2.0, 1.0])
    found = sampled_runs(hooks, rays, near, far, step(0))
    assert found is not None
    assert found.ray.tolist() == [0]
    assert (found.enter.item(), found.leave.item()) == (1.0, 3.0)


def test_where_rays_are_sampled_has_no_gradient(step) -> None:
    rays = some_rays(4)
    rays.origins.requires_grad_()
    for plugin in (Cells(grid=a_grid()), Function(where=lambda at: at[:, 2] < 0)):
        found = sampled_runs(Hooks({"one": plugin}), rays, rays.near, rays.far, step(0))
        assert found is not None and not found.enter.requires_grad
