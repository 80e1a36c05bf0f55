"""Whole images: skipping empty space changes nothing, and pixels are where they belong."""

from __future__ import annotations

import torch

from nerfreg.field import FieldConfig, RadianceField
from nerfreg.field.layers import Linear
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.occupancy import OccupancyGrid
from nerfreg.rendering.views import ViewRenderer
from nerfreg.scenes import Procedural, Scene


class Ball(RadianceField):
    """A field whose density is that of a ball of radius 0.5 around (0.3, 0, 0), opaque red."""

    def __init__(self, box: torch.Tensor) -> None:
        super().__init__(FieldConfig(levels=1, base=2, finest=2, log2_entries=6, hidden=4), box, make_layer)
        self.evaluated = 0

    def raw_density(self, positions: torch.Tensor, active: float | None = None) -> torch.Tensor:
        self.evaluated += len(positions)
        inside = (positions - torch.tensor([0.3, 0.0, 0.0])).norm(dim=-1) < 0.5
        raw = torch.zeros(len(positions), 16)
        raw[:, 0] = torch.where(inside, 8.0, -20.0)
        return raw

    def color(self, raw: torch.Tensor, harmonics: torch.Tensor, active: float | None = None) -> torch.Tensor:
        return torch.tensor([1.0, 0.0, 0.0]).expand(len(raw), 3)


def make_layer(network: str, index: int, inputs: int, outputs: int, activation: str) -> Linear:
    return Linear(inputs, outputs, activation)


def scene() -> Scene:
    return Procedural(size=48, views=3, test_views=1).load()


def test_occupied_cells_are_those_around_the_ball() -> None:
    box = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    grid = OccupancyGrid(Ball(box), 32)
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
    view = ViewRenderer(Ball(there.box), SamplerConfig(64, 128), there).view(there.cameras, there.test[0])
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


def test_a_strided_image_holds_every_so_manieth_pixel() -> None:
    there = scene()
    renderer = ViewRenderer(Ball(there.box), SamplerConfig(16, 16), there)
    whole, part = renderer.view(there.cameras, 0), renderer.view(there.cameras, 0, 5)
    torch.testing.assert_close(part.rgb, whole.rgb[::5, ::5])
    torch.testing.assert_close(part.depth, whole.depth[::5, ::5])
