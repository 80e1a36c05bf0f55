"""Whole images: skipping empty space changes nothing, and pixels are where they belong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import pytest
import torch

from nerfreg import Regularizer, hookimpl
from nerfreg.field import FieldConfig, RadianceField
from nerfreg.field.layers import Linear
from nerfreg.hooks import OccupancyGrid
from nerfreg.registry import Hooks
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.occupancy import occupied_by
from nerfreg.rendering.views import View, ViewRenderer
from nerfreg.scenes import Procedural, Scene


class Ball(RadianceField):
    """A field whose density is that of a ball of radius 0.5 around (0.3, 0, 0), opaque red."""

    def __init__(self, box: torch.Tensor) -> None:
        super().__init__(
            FieldConfig(levels=1, base=2, finest=2, log2_entries=6, hidden=4), box, make_layer
        )
        self.evaluated = 0
        self.active: set[tuple[str, float | None]] = set()

    def raw_density(self, positions: torch.Tensor, active: float | None = None) -> torch.Tensor:
        self.evaluated += len(positions)
        self.active.add(("density", active))
        inside = (positions - torch.tensor([0.3, 0.0, 0.0])).norm(dim=-1) < 0.5
        raw = torch.zeros(len(positions), 16)
        raw[:, 0] = torch.where(inside, 8.0, -20.0)
        return raw

    def color(
        self,
        raw: torch.Tensor,
        encoded: torch.Tensor,
        active: float | None = None,
        more: torch.Tensor | None = None,
    ) -> torch.Tensor:
        self.active.add(("color", active))
        return torch.tensor([1.0, 0.0, 0.0]).expand(len(raw), 3)


def make_layer(network: str, index: int, inputs: int, outputs: int, activation: str) -> Linear:
    return Linear(inputs, outputs, activation)


def scene() -> Scene:
    return Procedural(size=48, views=3, test_views=1).load()


def test_occupied_cells_are_those_around_the_ball() -> None:
    box = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    grid = occupied_by(Ball(box), 32)
    inside = torch.nn.functional.normalize(torch.randn(500, 3), dim=-1) * torch.rand(500, 1) * 0.5
    assert grid.contains(inside + torch.tensor([0.3, 0.0, 0.0])).all()
    # two cells of 1/16 beyond the surface, and a cell's diagonal, nothing is occupied
    outside = torch.nn.functional.normalize(torch.randn(500, 3), dim=-1) * 0.75
    assert not grid.contains((outside + torch.tensor([0.3, 0.0, 0.0])).clamp(-1, 1)).any()
    assert not grid.contains(torch.tensor([[-5.0, -5.0, -5.0]])).any()


def test_skipping_empty_space_changes_no_pixel_and_saves_work() -> None:
    there = scene()
    field = Ball(there.box)
    renderer = ViewRenderer(field, SamplerConfig(32, 32), there)
    field.evaluated = 0
    skipping = renderer.view(there.cameras, there.test[0])
    evaluated = field.evaluated
    renderer.occupancy.occupied.fill_(True)
    field.evaluated = 0
    everything = renderer.view(there.cameras, there.test[0])
    torch.testing.assert_close(skipping.rgb, everything.rgb, rtol=0, atol=1e-6)
    torch.testing.assert_close(skipping.depth, everything.depth)
    assert evaluated < field.evaluated / 2


def test_the_ball_is_seen_where_the_camera_projects_it() -> None:
    there = scene()
    view = ViewRenderer(Ball(there.box), SamplerConfig(64, 128), there).view(
        there.cameras, there.test[0]
    )
    red = (view.rgb - torch.tensor([1.0, 0.0, 0.0])).abs().sum(dim=-1) < 0.1
    y, x = red.nonzero(as_tuple=True)
    center = torch.stack([x.float().mean(), y.float().mean()]) + 0.5
    expected = there.cameras.project(torch.tensor([[0.3, 0.0, 0.0]]), there.test[0])[0]
    assert (center - expected).norm() < 1.0
    # the depth in the middle is the distance to the centre less the radius
    position = there.cameras.poses[there.test[0], :, 3]
    distance = (position - torch.tensor([0.3, 0.0, 0.0])).norm() - 0.5
    column, row = expected.floor().long().tolist()
    assert abs(float(view.depth[row, column] - distance)) < 0.05
    assert torch.equal(view.rgb[0, 0], torch.ones(3)) and view.opacity[0, 0] < 1e-6


@dataclass
class Moved(Regularizer):
    """What is at (0.3, 0, 0) is seen at (0, 0, 0), by some of the features."""

    in_evaluation: ClassVar[tuple[str, ...]] = ("nerfreg_encoder_input",)

    @hookimpl(wrapper=True)
    def nerfreg_encoder_input(self):
        samples = yield
        moved = samples.positions + torch.tensor([0.3, 0.0, 0.0])
        return replace(samples, positions=moved, density_features=1.0, color_features=5.0)


def test_encoders_see_what_a_plugin_makes_of_the_samples_if_it_asks_for_it(step) -> None:
    there = scene()
    field = Ball(there.box)
    evaluation = replace(step(index=50), training=False)
    renderer = ViewRenderer(
        field, SamplerConfig(64, 128), there, Hooks({"moved": Moved()}), evaluation
    )
    view = renderer.view(there.cameras, there.test[0])
    assert field.active == {("density", 1.0), ("color", 5.0)}
    y, x = (view.opacity > 0.5).nonzero(as_tuple=True)
    center = torch.stack([x.float().mean(), y.float().mean()]) + 0.5
    expected = there.cameras.project(torch.zeros(1, 3), there.test[0])[0]
    assert (center - expected).norm() < 1.0


def test_a_strided_image_holds_every_nth_pixel() -> None:
    there = scene()
    renderer = ViewRenderer(Ball(there.box), SamplerConfig(16, 16), there)
    whole, part = renderer.view(there.cameras, 0), renderer.view(there.cameras, 0, 5)
    # The intervals follow the pixels around, which are others: at the rim a ray may just meet the
    # ball or just miss it.
    same = (part.rgb - whole.rgb[::5, ::5]).abs().amax(dim=-1) < 1e-5
    assert same.float().mean() > 0.98
    torch.testing.assert_close(part.depth[same], whole.depth[::5, ::5][same], rtol=0, atol=0.05)


@pytest.mark.parametrize("block", [1, 2, 4, 5])
def test_blocks_share_where_they_look_and_not_what_they_see(block: int) -> None:
    # 48 pixels are no multiple of 5: the last block reaches beyond the image.
    there = scene()
    sampler = SamplerConfig(64, 0, view_samples=64, view_block=block)
    view = ViewRenderer(Ball(there.box), sampler, there).view(there.cameras, there.test[0])
    exact = ball_depth(there)
    hit = exact.isfinite()
    assert view.rgb.shape == (48, 48, 3)
    # at the rim a pixel is half in, half out of the ball's last intervals
    assert ((view.opacity > 0.5) == hit).float().mean() > 0.99
    error = (view.depth - exact)[hit].abs()
    assert error.median() < 0.01 and error.quantile(0.8) < 0.1


def test_what_lies_behind_something_opaque_is_not_looked_at() -> None:
    there = scene()
    field = Ball(there.box)
    renderer = ViewRenderer(field, SamplerConfig(64, 0, view_samples=64, view_block=4), there)
    renderer.occupancy.occupied.fill_(True)
    renderer.view(there.cameras, there.test[0])
    hit = ball_depth(there).isfinite().float().mean()
    # Of 64 intervals of a ray that meets the ball less than half lie before it or in its first
    # tenth.
    assert renderer.points < 48 * 48 * (64 / 16 + 64 * (1 - 0.4 * hit))
    assert renderer.colors < renderer.points


class BallBeforeWall(Ball):
    """A ball in the middle, and a wall behind it as seen from a camera."""

    def __init__(self, box: torch.Tensor, camera: torch.Tensor) -> None:
        super().__init__(box)
        self.camera = torch.nn.functional.normalize(camera, dim=0)

    def raw_density(self, positions: torch.Tensor, active: float | None = None) -> torch.Tensor:
        solid = (positions.norm(dim=-1) < 0.4) | (positions @ self.camera < -0.45)
        raw = torch.zeros(len(positions), 16)
        raw[:, 0] = torch.where(solid, 8.0, -20.0)
        return raw


def test_past_the_rim_of_something_the_rest_is_seen() -> None:
    # A scout that meets the ball is stopped by it, and some pixels of its block look past the ball,
    # at the wall.
    there = scene()
    field = BallBeforeWall(there.box, there.cameras.poses[there.test[0], :, 3])
    views = [
        ViewRenderer(field, SamplerConfig(view_block=block), there).view(
            there.cameras, there.test[0]
        )
        for block in (1, 4)
    ]
    holes = (views[0].opacity > 0.9) & (views[1].opacity < 0.5)
    assert (views[0].opacity > 0.9).sum() > 500
    # all around the ball there would be 40; one or two rays only just meet the end of the wall
    assert holes.sum() < 5


def ball_depth(there: Scene) -> torch.Tensor:
    """Distance (H, W) at which the rays of the first test view meet the ball, or infinity."""
    y, x = torch.meshgrid(torch.arange(48), torch.arange(48), indexing="ij")
    pixels = torch.stack([x, y], dim=-1).view(-1, 2)
    origins, directions = there.cameras.rays(torch.full((48 * 48,), there.test[0]), pixels)
    # |o + t d - c|^2 = 1/4 with |d| = 1: t = b - sqrt(b^2 - |o - c|^2 + 1/4), b = (c - o) d
    to_center = torch.tensor([0.3, 0.0, 0.0]) - origins
    b = (to_center * directions).sum(dim=1)
    root = b.square() - to_center.square().sum(dim=1) + 0.25
    return torch.where(root > 0, b - root.clamp_min(0).sqrt(), torch.inf).view(48, 48)


@dataclass
class Cells(Regularizer):
    """A grid of cells declares space empty."""

    grid: Any = None

    @hookimpl
    def nerfreg_occupancy(self):
        return self.grid


@dataclass
class Outside(Regularizer):
    """A function declares space empty outside of all grids."""

    grids: Any = ()

    @hookimpl
    def nerfreg_empty(self, positions):
        return ~torch.stack([grid.contains(positions) for grid in self.grids]).all(dim=0)


def cells(there: Scene, part: Any) -> OccupancyGrid:
    """The cells whose centres lie in a part of space."""
    everywhere = torch.ones((40,) * 3, dtype=torch.bool)
    grid = OccupancyGrid.over(there.info.center, there.info.half_box, everywhere)
    return OccupancyGrid(part(grid.centers), grid.low, grid.cell)


def right_half(centers: torch.Tensor) -> torch.Tensor:
    return centers[..., 0] > 0.3


def in_front(centers: torch.Tensor) -> torch.Tensor:
    return centers[..., 1].abs() < 0.35


def around(centers: torch.Tensor) -> torch.Tensor:
    return (centers - torch.tensor([0.3, 0.0, 0.0])).norm(dim=-1) < 0.6


def seen(there: Scene, step: Any, *plugins: Regularizer, block: int = 1) -> View:
    hooks = Hooks({f"plugin{number}": plugin for number, plugin in enumerate(plugins)})
    evaluation = replace(step(index=50), training=False)
    sampler = SamplerConfig(64, 128, view_samples=256, view_block=block)
    renderer = ViewRenderer(Ball(there.box), sampler, there, hooks, evaluation)
    return renderer.view(there.cameras, there.test[0])


def misses(there: Scene, *grids: OccupancyGrid) -> torch.Tensor:
    """Which pixels (H, W) see none of the cells that are occupied in all of the grids."""
    origins, directions = there.cameras.image_rays(there.test[0])
    near, far = there.info.clipped(origins, directions)
    t = torch.lerp(near[:, None], far[:, None], torch.linspace(0, 1, 2000))
    at = (origins[:, None] + directions[:, None] * t[..., None]).view(-1, 3)
    inside = torch.stack([grid.contains(at) for grid in grids]).all(dim=0)
    return ~inside.view(t.shape).any(dim=1).view(48, 48)


@pytest.mark.parametrize("parts", [(right_half,), (around,), (right_half, in_front)])
def test_views_of_grids_are_those_of_the_same_emptiness_by_a_function(parts: Any, step) -> None:
    there = scene()
    grids = [cells(there, part) for part in parts]
    by_grid = seen(there, step, *[Cells(grid=grid) for grid in grids])
    by_function = seen(there, step, Outside(grids=grids))
    # At the rim, a pixel just meets the ball or just misses it.
    same = (by_grid.rgb - by_function.rgb).abs().amax(dim=-1) < 1e-2
    assert same.float().mean() > 0.995
    torch.testing.assert_close(by_grid.depth[same], by_function.depth[same], rtol=0, atol=0.02)
    assert 20 < (by_grid.opacity > 0.5).sum() < 1500
    empty = misses(there, *grids)
    assert empty.any()
    assert (by_grid.rgb[empty] == 1).all() and (by_grid.opacity[empty] == 0).all()


def test_a_grid_around_what_is_there_leaves_the_picture_as_it_is(step) -> None:
    there = scene()
    plain = seen(there, step)
    hull = seen(there, step, Cells(grid=cells(there, around)))
    same = (hull.rgb - plain.rgb).abs().amax(dim=-1) < 1e-2
    assert same.float().mean() > 0.995
    torch.testing.assert_close(hull.depth[same], plain.depth[same], rtol=0, atol=0.02)
    # Empty rays end with the box, as they do without a grid.
    empty = plain.opacity < 1e-6
    assert empty.sum() > 1000 and torch.equal(hull.depth[empty], plain.depth[empty])


def test_blocks_that_see_cells_in_part(step) -> None:
    there = scene()
    grid = cells(there, right_half)
    exact, blocks = (seen(there, step, Cells(grid=grid), block=block) for block in (1, 4))
    assert ((exact.opacity > 0.5) == (blocks.opacity > 0.5)).float().mean() > 0.99
    empty = misses(there, grid)
    assert (blocks.opacity[empty] == 0).all()
    assert torch.equal(blocks.depth[empty], exact.depth[empty])


def test_where_nothing_is_left_a_view_is_its_background(step) -> None:
    there = scene()
    nothing = cells(there, lambda centers: centers[..., 0] > 99)
    view = seen(there, step, Cells(grid=nothing), block=4)
    assert (view.rgb == 1).all() and (view.opacity == 0).all()
    plain = seen(replace(there), step, Cells(grid=cells(there, around)))
    corner = plain.depth[0, 0]
    assert view.depth[0, 0] == corner
