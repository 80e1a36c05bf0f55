"""What the hull leaves out, when the plugin does nothing, and its checkpoint."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import mpmath
import pytest
import torch
from nerfreg_plugins.references.silhouettes import projected_corners
from nerfreg_plugins.silhouettes import Silhouettes
from nerfreg_plugins.silhouettes import hull as hull_module
from nerfreg_plugins.silhouettes.views import PinholeView

from nerfreg import OccupancyGrid
from nerfreg.errors import NerfregError, NerfregWarning
from nerfreg.numerics import exact
from nerfreg.scenes.cameras import Cameras


def volume(grid: OccupancyGrid) -> float:
    return float(grid.occupied.sum()) * grid.cell**3


def test_the_hull_of_a_ball_approaches_the_ball(cameras, photographs, hull, ball):
    # Of many views, fine pixels and fine cells; each step is closer to the ball, from outside.
    true, found = 4 / 3 * math.pi * 0.5**3, []
    for views, size, resolution in ((3, 32, 24), (12, 64, 48), (40, 160, 96)):
        made = cameras(views, size=size, field_of_view=0.45)
        taken = photographs([ball((0.1, 0.0, 0.0), 0.5)], made, samples=2)
        found.append(volume(hull(taken, resolution=resolution)) / true)
    assert 1 < found[2] < found[1] < found[0]
    # What is left is a shell of a cell and a pixel of margin, each 0.011 wide, and of the cells
    # that the border of the silhouette crosses.
    assert found[2] < 1.2


def test_every_cell_meets_every_silhouette(several, cameras, photographs, hull):
    taken = photographs(several, cameras(5))
    grid = hull(taken, margin=1.0)
    centers = grid.centers[grid.occupied]
    corners = torch.cartesian_prod(*[torch.tensor([-0.5, 0.5])] * 3) * grid.cell
    for view in range(5):
        pixels = taken.cameras.project((centers[:, None] + corners).view(-1, 3), view)
        x, y = pixels.view(-1, 8, 2).unbind(dim=2)
        covered = (taken.images[view, ..., 3] > 0.01).nonzero().float() + 0.5
        # The rectangle of the cell, half a pixel and the margin around the nearest covered centre;
        # half as much again for the box along the axes of the camera that stands for the cell.
        middle = torch.stack([y.mean(dim=1), x.mean(dim=1)], dim=1)
        reach = torch.stack([y.amax(1) - y.amin(1), x.amax(1) - x.amin(1)], dim=1) * 0.75 + 2.0
        near = (middle[:, None] - covered).abs() <= reach[:, None]
        assert near.all(dim=2).any(dim=1).all()


def test_a_view_by_hand():
    # One covered pixel of 8 x 8, seen along -z from z = 4 with a focal length of 8.
    covered = torch.zeros(8, 8, dtype=torch.bool)
    covered[2, 5] = True
    view = looking_along_z(covered, margin=0.0)
    # At depth 4 the pixel spans x from 0.5 to 1 and y from 0.5 to 1, with y up.
    for x, y, half, expected in (
        (0.75, 0.75, 0.01, True),
        (0.51, 0.99, 0.001, True),
        (0.45, 0.75, 0.01, False),
        (0.45, 0.75, 0.06, True),
        (0.75, 1.05, 0.01, False),
        (-0.75, 0.75, 0.01, False),
    ):
        possible = torch.ones(1, dtype=torch.bool)
        view.exclude(possible, torch.tensor([[x, y, 0.0]], dtype=torch.float64), half)
        assert possible.item() is expected, (x, y, half)
    # A margin of half a pixel counts as a whole one: from 0 to 1.5.
    view = looking_along_z(covered, margin=0.5)
    centers = torch.tensor([[0.1, 0.75, 0.0], [-0.1, 0.75, 0.0]], dtype=torch.float64)
    possible = torch.ones(2, dtype=torch.bool)
    view.exclude(possible, centers, 0.01)
    assert possible.tolist() == [True, False]


@pytest.mark.parametrize("frame", [True, False])
def test_what_a_view_does_not_show(frame):
    covered = torch.zeros(8, 8, dtype=torch.bool)
    covered[3, 3] = True
    view = looking_along_z(covered, margin=0.0, frame=frame)
    # Behind the camera, beside the image, across the camera's plane far away from the axis.
    centers = torch.tensor([[0, 0, 5], [9, 0, 0], [5, 0, 4.0]], dtype=torch.float64)
    possible = torch.ones(3, dtype=torch.bool)
    view.exclude(possible, centers, 0.1)
    assert possible.tolist() == [not frame] * 3
    # Around the camera, anything may be shown.
    possible = torch.ones(1, dtype=torch.bool)
    view.exclude(possible, torch.tensor([[0, 0, 4.0]], dtype=torch.float64), 0.1)
    assert possible.item()


def looking_along_z(covered, margin, frame=True) -> PinholeView:
    pose = torch.eye(4)[None, :3].clone()
    pose[0, 2, 3] = 4
    cameras = Cameras(
        8, 8, pose, torch.full((1, 2), 8.0), torch.full((1, 2), 4.0), torch.zeros(1, 5)
    )
    return PinholeView.of(cameras, 0, covered, margin, frame)


def test_the_rectangle_contains_the_exact_projection(cameras):
    # All but one pixel is empty: cubes whose exact projection contains it must be kept.
    made = cameras(6)
    draw = torch.Generator().manual_seed(0)
    centers = torch.rand(300, 3, dtype=torch.float64, generator=draw) * 2 - 1
    axes_sign, met = torch.tensor([1.0, -1.0, -1.0]), 0
    for view in range(6):
        axes = (made.poses[view, :, :3] * axes_sign).T.double()
        for center in centers.tolist():
            with mpmath.workdps(30):
                corners = projected_corners(
                    exact(torch.tensor(center)),
                    mpmath.mpf("0.03"),
                    exact(made.poses[view, :, 3]),
                    exact(axes),
                    exact(made.focal[view]),
                    exact(made.center[view]),
                )
            for x, y in corners:
                if not (1 <= x < 31 and 1 <= y < 31):
                    continue
                covered = torch.zeros(32, 32, dtype=torch.bool)
                covered[int(y), int(x)] = True
                seen = PinholeView.of(made, view, covered, 0.0, True)
                possible = torch.ones(1, dtype=torch.bool)
                seen.exclude(possible, torch.tensor([center], dtype=torch.float64), 0.03)
                assert possible.item()
                met += 1
                break
    assert met > 100


def test_memory_is_bounded(several, cameras, photographs, hull, monkeypatch):
    taken = photographs(several, cameras(4))
    expected = hull(taken)
    most = []
    original = hull_module._possible

    def watched(views, places, low, cell):
        most.append(len(places))
        return original(views, places, low, cell)

    monkeypatch.setattr(hull_module, "CHUNK", 2**12)
    monkeypatch.setattr(hull_module, "_possible", watched)
    assert torch.equal(hull(taken).occupied, expected.occupied)
    assert max(most) <= 2**12


@pytest.mark.parametrize("alpha", [0.0, 1.0])
def test_alpha_that_is_the_same_everywhere(several, cameras, photographs, hull, alpha):
    taken = photographs(several, cameras(3))
    taken.images[..., 3] = alpha
    with pytest.warns(NerfregWarning, match="does nothing: neither alpha nor masks") as said:
        assert hull(taken) is None
    assert len(said) == 1


def test_photographs_without_alpha(several, cameras, photographs, hull):
    taken = photographs(several, cameras(3))
    with pytest.warns(NerfregWarning, match="does nothing: neither alpha nor masks"):
        assert hull(replace(taken, images=taken.images[..., :3])) is None


def test_silhouettes_that_contradict_each_other(several, cameras, photographs, hull):
    taken = photographs(several, cameras(6))
    wrong = replace(taken, cameras=cameras(6, seed=5))
    with pytest.warns(NerfregWarning, match="does nothing: the silhouettes contradict") as said:
        assert hull(wrong) is None
    assert len(said) == 1


def test_cells_of_a_grid_of_any_shape_are_packed_and_unpacked(several, cameras, photographs):
    plugin, taken = Silhouettes(resolution=41), photographs(several, cameras(5))
    cells = plugin.nerfreg_module()
    assert plugin.nerfreg_occupancy() is None
    plugin.nerfreg_prepare(taken)
    direct = hull_module.visual_hull(taken, taken.images[..., 3] > 0.01, 41, 1.0, True)
    x, y, z = direct.occupied.shape
    grid = plugin.nerfreg_occupancy()
    assert torch.equal(grid.occupied[:x, :y, :z], direct.occupied)
    assert grid.occupied.sum() == direct.occupied.sum()
    assert (grid.cell, grid.low.tolist()) == (direct.cell, direct.low.tolist())
    # The same object, until the cells change.
    assert plugin.nerfreg_occupancy() is grid
    other = Silhouettes(resolution=41)
    restored = other.nerfreg_module()
    assert other.nerfreg_occupancy() is None
    restored.load_state_dict(cells.state_dict())
    again = other.nerfreg_occupancy()
    assert torch.equal(again.occupied, grid.occupied)
    assert (again.cell, again.low.tolist()) == (grid.cell, grid.low.tolist())
    restored.to(torch.float64)
    assert torch.equal(other.nerfreg_occupancy().occupied, grid.occupied)
    assert other.nerfreg_occupancy().low.dtype == torch.float64
    cells.bits.zero_()
    assert not plugin.nerfreg_occupancy().occupied.any()


def test_bounds_are_empty(several, cameras, photographs, hull):
    # Outside of the grid the nearest cell counts, which must therefore be empty.
    grid = hull(photographs(several, cameras(1)), resolution=30)
    assert grid.occupied.any()
    for axis in range(3):
        assert not grid.occupied.select(axis, 0).any()
        assert not grid.occupied.select(axis, -1).any()


RUN = ("+reg=silhouettes", "reg.silhouettes.resolution=40", "scene.views=6", "scene.size=32")


def test_a_run_and_its_checkpoint(make):
    trainer = make(*RUN)
    for _ in range(3):
        trainer.step()
    positions = 2 * torch.rand(5000, 3) - 1
    step = trainer._step()
    empty = trainer.hooks.empty(positions, step)
    assert 0.3 < empty.float().mean() < 1
    assert not step.field.density(positions)[empty].any()
    fresh = make(*RUN)
    # As a field is loaded: by plugins that have prepared nothing.
    fresh.field.plugins["silhouettes"].cell.zero_()
    assert fresh.hooks.empty(positions, fresh._step()) is None
    fresh.field.load_state_dict(trainer.field.state_dict())
    assert torch.equal(fresh.hooks.empty(positions, fresh._step()), empty)


def test_true_surfaces_of_a_run_are_kept(make):
    trainer = make(*RUN)
    scene = trainer.scene
    for view in (*scene.train, *scene.test):
        origins, directions = scene.cameras.image_rays(view)
        depth = scene.read_depth(view).flatten()
        surface = (origins + directions * (depth[:, None] + 1e-4))[depth.isfinite()]
        assert not trainer.hooks.empty(surface, trainer._step()).any()


@pytest.mark.parametrize(
    "option", [{"resolution": 4}, {"alpha": 1.5}, {"margin": -1.0}, {"margin": math.nan}]
)
def test_values_out_of_range(option):
    with pytest.raises(NerfregError, match=rf"reg\.silhouettes\.{next(iter(option))}="):
        Silhouettes(**option)


def test_nothing_is_said_where_all_is_well(several, cameras, photographs, hull):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert hull(photographs(several, cameras(3))) is not None
