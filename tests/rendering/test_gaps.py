"""The renderer where rays have gaps: in samples, values, gradients and repetitions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from nerfreg import Regularizer, hookimpl
from nerfreg.field import FieldConfig, RadianceField
from nerfreg.field.directions import spherical_harmonics
from nerfreg.field.layers import Linear
from nerfreg.hooks import OccupancyGrid, Rays, Rendering, Samples, Step
from nerfreg.rays.traversal import occupied_runs
from nerfreg.registry import Hooks
from nerfreg.rendering.compositing import composite
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.renderer import Renderer

BOX = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
SAMPLER = SamplerConfig(12, 20, inside=1.0)


@dataclass
class Cells(Regularizer):
    """A grid of cells."""

    grid: Any = None

    @hookimpl
    def nerfreg_occupancy(self):
        return self.grid


@dataclass
class Outside(Regularizer):
    """The same by a function."""

    grid: Any = None

    @hookimpl
    def nerfreg_empty(self, positions):
        return ~self.grid.contains(positions)


@pytest.fixture
def field() -> RadianceField:
    torch.manual_seed(0)
    config = FieldConfig(levels=4, base=4, finest=16, log2_entries=10, hidden=16, geometry=7)
    field = RadianceField(
        config, BOX, lambda network, index, i, o, activation: Linear(i, o, activation)
    )
    torch.nn.init.uniform_(field.grid.table, -3, 3)
    return field


@pytest.fixture
def grid() -> OccupancyGrid:
    """Two slabs and what is random between them, so that rays have one to five spans."""
    occupied = torch.rand(16, 16, 16, generator=torch.Generator().manual_seed(0)) < 0.2
    occupied[:, :, 1:3] = occupied[:, :, 11:13] = True
    occupied[:8] = False
    return OccupancyGrid.over(torch.zeros(3), 1.0, occupied)


def some_rays(count: int = 40, groups: Tensor | None = None) -> Rays:
    """Rays down the axis z from above, of which about a tenth meet nothing."""
    generator = torch.Generator().manual_seed(1)
    origins = torch.tensor([0.4, 0.0, 3.0]) + 0.3 * torch.randn(count, 3, generator=generator)
    ahead = torch.tensor([0.0, 0.0, -1.0]) + 0.05 * torch.randn(count, 3, generator=generator)
    colors = torch.rand(2, count, 3, generator=generator)
    return Rays(
        origins,
        functional.normalize(ahead, dim=1),
        torch.full((count,), 2.0),
        torch.full((count,), 4.0),
        *colors,
        groups=groups,
    )


def a_step(seed: int = 0) -> Step:
    return Step(0, 10, 0.0, torch.Generator().manual_seed(seed), (2.0, 4.0))


def positions(made: Rendering) -> Tensor:
    return made.rays.origins[:, None] + made.rays.directions[:, None] * made.t[..., None]


def renderer(field: RadianceField, *plugins: Regularizer) -> Renderer:
    named = {f"plugin{number}": plugin for number, plugin in enumerate(plugins)}
    return Renderer(field, SAMPLER, Hooks(named))


def test_samples_are_inside_and_intervals_as_long(
    field: RadianceField, grid: OccupancyGrid
) -> None:
    rays = some_rays()
    drawn = renderer(field, Cells(grid=grid))
    made = drawn.render(rays, a_step())
    runs = occupied_runs(grid, rays.origins, rays.directions, rays.near, rays.far)
    count = torch.bincount(runs.ray, minlength=40)
    assert count.min() == 0 and 2 < count.max() <= 8
    lengths = torch.zeros(40).index_add(0, runs.ray, runs.leave - runs.enter)
    assert (made.t.diff(dim=1) >= 0).all() and (made.t_edges.diff(dim=1) >= 0).all()
    assert (made.t_edges[:, :-1] <= made.t).all() and (made.t <= made.t_edges[:, 1:]).all()
    # All rays have as many places as that of most spans needs: its gaps come on top of 12 + 20.
    assert made.t.shape[1] == 32 + int(count.max()) - 1
    full = grid.contains(positions(made).view(-1, 3)).view(made.t.shape)
    met = count > 0
    deltas = made.t_edges.diff(dim=1)
    found = (deltas * full).sum(dim=1)
    torch.testing.assert_close(found[met], lengths[met], rtol=0, atol=2e-5)
    # No sample is wasted: 32 of each ray that meets something are evaluated, but for rounding.
    assert drawn.points <= 32 * int(met.sum())
    assert drawn.points > 0.995 * 32 * int(met.sum())
    assert (made.density[~full] == 0).all() and (made.density[full & (deltas > 0)] > 0).all()
    # From the first cell to the last, and all of a ray that meets nothing.
    assert torch.equal(made.t_edges[~met, 0], rays.near[~met])
    assert torch.equal(made.depth[~met], rays.far[~met])
    background = rays.background
    assert background is not None and torch.equal(made.rgb[~met], background[~met])


def test_a_rendering_with_gaps_is_the_composite_of_its_samples(
    field: RadianceField, grid: OccupancyGrid
) -> None:
    rays = some_rays()
    made = renderer(field, Cells(grid=grid)).render(rays, a_step())
    flat = positions(made).view(-1, 3)
    full = grid.contains(flat).view(made.t.shape)
    raw = field.raw_density(flat)
    harmonics = spherical_harmonics(rays.directions).repeat_interleave(made.t.shape[1], dim=0)
    color = field.color(raw, harmonics).view(*made.t.shape, 3)
    density = field.density(raw).view(made.t.shape) * full
    expected = composite(density, color, made.t_edges, rays.background)
    torch.testing.assert_close(made.weights, expected.weights, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(made.depth, expected.depth)
    torch.testing.assert_close(made.rgb, expected.rgb, rtol=0, atol=40e-4)


def test_gradients_with_gaps_are_those_of_the_plain_composite(
    field: RadianceField, grid: OccupancyGrid
) -> None:
    rays = some_rays()
    made = renderer(field, Cells(grid=grid)).render(rays, a_step())
    (made.rgb.sum() + made.depth.sum()).backward()
    fused = {name: p.grad.clone() for name, p in field.named_parameters() if p.grad is not None}
    field.zero_grad()
    flat = positions(made).view(-1, 3)
    full = grid.contains(flat).view(made.t.shape)
    raw = field.raw_density(flat)
    harmonics = spherical_harmonics(rays.directions).repeat_interleave(made.t.shape[1], dim=0)
    color = field.color(raw, harmonics).view(*made.t.shape, 3) * made.colored[..., None]
    plain = composite(
        field.density(raw).view(made.t.shape) * full, color, made.t_edges, rays.background
    )
    assert plain.rgb is not None
    (plain.rgb.sum() + plain.depth.sum()).backward()
    assert fused
    for name, parameter in field.named_parameters():
        assert parameter.grad is not None
        scale = float(parameter.grad.abs().max())
        torch.testing.assert_close(fused[name], parameter.grad, rtol=1e-3, atol=1e-4 * scale)


def test_gradients_with_gaps_are_finite_differences(
    field: RadianceField, grid: OccupancyGrid
) -> None:
    """By the layers of the density network, in double precision and at the same samples."""
    field = field.double()
    rays = some_rays()
    rays = replace(
        rays,
        **{
            name: getattr(rays, name).double()
            for name in ("origins", "directions", "near", "far", "targets", "background")
        },
    )
    drawn = renderer(field, Cells(grid=grid))
    first = drawn.render(rays, a_step())

    def value() -> Tensor:
        made = drawn.render(rays, a_step(), like=first)
        return made.rgb.square().sum() + made.depth.sum()

    weight = next(iter(field.density_network.parameters()))
    assert weight.dtype == torch.float64
    total = value()
    total.backward()
    assert weight.grad is not None
    generator = torch.Generator().manual_seed(0)
    for _ in range(5):
        along = torch.randn(weight.shape, generator=generator, dtype=torch.float64)
        sides = []
        for sign in (1, -1):
            with torch.no_grad():
                weight.add_(sign * 1e-6 * along)
                sides.append(value().item())
                weight.sub_(sign * 1e-6 * along)
        slope = (sides[0] - sides[1]) / 2e-6
        assert slope == pytest.approx((weight.grad * along).sum().item(), rel=1e-4, abs=1e-6)


def test_rays_of_a_group_share_the_union(field: RadianceField, grid: OccupancyGrid) -> None:
    groups = torch.arange(40) // 2
    rays = some_rays(groups=groups)
    made = renderer(field, Cells(grid=grid)).render(rays, a_step())
    pairs = made.t_edges.view(20, 2, -1), made.t.view(20, 2, -1)
    for pair in pairs:
        assert torch.equal(pair[:, 0], pair[:, 1])
    # Each place is inside for one of the two, or in a gap of both, or without length.
    full = grid.contains(positions(made).view(-1, 3)).view(20, 2, -1)
    density, deltas = made.density.view(20, 2, -1), made.t_edges.diff(dim=1).view(20, 2, -1)
    assert (density[~full] == 0).all() and (density[full & (deltas > 0)] > 0).all()
    runs = occupied_runs(grid, rays.origins, rays.directions, rays.near, rays.far)
    ends = torch.zeros(40).scatter_reduce(0, runs.ray, runs.leave, "amax").view(20, 2)
    met = ends.amax(dim=1) > 0
    assert torch.equal(pairs[0][met, 0, -1], ends.amax(dim=1)[met])
    alone = renderer(field, Cells(grid=grid)).render(some_rays(), a_step())
    assert not torch.equal(alone.t_edges[0, 1:5], alone.t_edges[1, 1:5])
    # Gaps are left out where both rays have them.
    lengths = torch.zeros(40).index_add(0, runs.ray, runs.leave - runs.enter).view(20, 2)
    inside = (deltas[:, 0] * full.any(dim=1)).sum(dim=1)
    assert (inside[met] >= lengths.amax(dim=1)[met] - 1e-4).all()
    assert (inside[met] <= lengths.sum(dim=1)[met] + 1e-4).all()


def test_a_repetition_equals_the_first(field: RadianceField, grid: OccupancyGrid) -> None:
    for plugin in (Cells(grid=grid), Outside(grid=grid)):
        drawn = renderer(field, plugin)
        made = drawn.render(some_rays(), a_step())
        again = drawn.render(made.rays, a_step(1), like=made)
        assert torch.equal(again.t, made.t) and torch.equal(again.t_edges, made.t_edges)
        torch.testing.assert_close(again.weights, made.weights, rtol=1e-4, atol=1e-7)
        torch.testing.assert_close(again.rgb, made.rgb)
        torch.testing.assert_close(again.depth, made.depth)


def test_a_function_and_a_grid_agree(field: RadianceField, grid: OccupancyGrid) -> None:
    rays = some_rays(200)
    sampler = SamplerConfig(256, 0, inside=1.0)
    by_grid, by_function = (
        Renderer(field, sampler, Hooks({"plugin": plugin})).render(rays, a_step())
        for plugin in (Cells(grid=grid), Outside(grid=grid))
    )
    # The function's spans reach beyond the cells by up to two parts of 128; intervals that lie
    # across the border of a cell count as a whole or not at all.
    error = (by_grid.opacity - by_function.opacity).abs()
    assert error.mean() < 0.02
    assert (by_grid.rgb - by_function.rgb).abs().mean() < 0.02


def test_directions_that_differ_along_a_ray_follow_their_samples_past_gaps(
    field: RadianceField, grid: OccupancyGrid
) -> None:
    class PerSample(Hooks):
        split = 0.0

        def encoder_input(self, samples: Samples, step: Step) -> Samples:
            directions = samples.directions[:, None].expand(*samples.t.shape, 3)
            turned = torch.where(samples.t[..., None] < self.split, -directions, directions)
            return replace(samples, directions=turned)

    rays = some_rays()
    plain = renderer(field, Cells(grid=grid)).render(rays, a_step())
    hooks = PerSample({"cells": Cells(grid=grid)})
    turning = Renderer(field, SAMPLER, hooks)
    torch.testing.assert_close(turning.render(rays, a_step()).rgb, plain.rgb)
    hooks.split = 3.0
    turned = turning.render(rays, a_step())
    assert not torch.allclose(turned.rgb, plain.rgb)
    # A repetition evaluates all samples at once and in order, gaps among them.
    torch.testing.assert_close(turning.render(rays, a_step(), like=turned).rgb, turned.rgb)


def test_a_grid_that_leaves_nothing_out_changes_nothing(field: RadianceField) -> None:
    everything = OccupancyGrid.over(torch.zeros(3), 1.0, torch.ones(9, 9, 9, dtype=torch.bool))
    rays = some_rays()
    plain = renderer(field).render(rays, a_step())
    made = renderer(field, Cells(grid=everything)).render(rays, a_step())
    for name in ("t", "t_edges", "density", "rgb", "depth"):
        assert torch.equal(getattr(made, name), getattr(plain, name)), name


def test_fewer_samples_than_spans(field: RadianceField, grid: OccupancyGrid) -> None:
    rays = some_rays()
    for coarse, fine in ((1, 0), (1, 3), (2, 2)):
        drawn = Renderer(
            field, SamplerConfig(coarse, fine, inside=1.0), Hooks({"cells": Cells(grid=grid)})
        )
        made = drawn.render(rays, a_step())
        assert made.t.shape[1] <= coarse + fine + coarse - 1
        assert (made.t_edges.diff(dim=1) >= 0).all() and made.rgb.isfinite().all()
        assert drawn.points > 0


def test_rays_that_miss_the_box_beside_rays_with_gaps(
    field: RadianceField, grid: OccupancyGrid
) -> None:
    rays = some_rays()
    rays.far[::3] = rays.near[::3]
    for spacing in ("linear", "disparity"):
        sampler = SamplerConfig(12, 20, spacing=spacing, inside=1.0)
        made = Renderer(field, sampler, Hooks({"cells": Cells(grid=grid)})).render(rays, a_step())
        assert made.t.isfinite().all() and made.rgb.isfinite().all()
        assert rays.background is not None
        torch.testing.assert_close(made.rgb[::3], rays.background[::3])
        assert torch.equal(made.depth[::3], rays.far[::3])
        field.zero_grad()
        made.rgb.sum().backward()
        assert all(p.grad is None or p.grad.isfinite().all() for p in field.parameters())


def test_importance_samples_gather_where_density_is(
    field: RadianceField, grid: OccupancyGrid
) -> None:
    """With a wall in the second slab alone, most importance samples lie there, and none in gaps."""

    class Wall(RadianceField):
        def raw_density(self, at: Tensor, active: float | None = None) -> Tensor:
            raw = super().raw_density(at, active)
            solid = (at[:, 2] < -0.6) & (at[:, 2] > -0.9)
            density = torch.where(solid, 5.0, -20.0)[:, None]
            return torch.cat([density, raw[:, 1:]], dim=1)

    field.__class__ = Wall
    occupied = grid.occupied.clone()
    occupied[8:, :, 3:11] = False
    slabs = OccupancyGrid(occupied, grid.low, grid.cell)
    made = Renderer(
        field, SamplerConfig(8, 24, inside=1.0), Hooks({"cells": Cells(grid=slabs)})
    ).render(some_rays(), a_step())
    z = positions(made)[..., 2]
    hit = made.opacity > 0.9
    assert hit.sum() > 20
    solid = (z < -0.6) & (z > -0.9)
    assert (solid.sum(dim=1)[hit] >= 24).all()


def test_rays_with_known_empty_space_get_a_share_of_the_samples(
    field: RadianceField, grid: OccupancyGrid
) -> None:
    rays, sampler = some_rays(), SamplerConfig(16, 24, inside=0.25)
    hooks = Hooks({"cells": Cells(grid=grid)})
    made = Renderer(field, sampler, hooks).render(rays, a_step())
    runs = occupied_runs(grid, rays.origins, rays.directions, rays.near, rays.far)
    spans = torch.bincount(runs.ray, minlength=40)
    # A quarter of both, 4 + 6, and no more spans than there are coarse samples.
    assert spans.max() > 4 and made.t.shape[1] == 10 + 3
    assert Renderer(field, sampler, Hooks()).render(rays, a_step()).t.shape[1] == 40
