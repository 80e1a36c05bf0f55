"""Whole images: skipping empty space changes nothing, and pixels are where they belong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import pytest
import torch

from nerfreg import Regularizer, hookimpl
from nerfreg.field import FieldConfig, RadianceField
from nerfreg.field.layers import Linear
from nerfreg.registry import Hooks
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.occupancy import occupied_by
from nerfreg.rendering.views import ViewRenderer
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
