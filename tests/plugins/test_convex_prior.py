from __future__ import annotations

import math
import warnings
from dataclasses import replace
from types import SimpleNamespace

import mpmath
import pytest
import torch
from nerfreg_plugins.convex_prior import (
    CROWD,
    ConvexPrior,
    directions,
    outside_opacity,
    support_planes,
)
from nerfreg_plugins.references import convex_prior as reference
from torch.nn.functional import normalize

from nerfreg import Photographs
from nerfreg.errors import NerfregError, NerfregWarning
from nerfreg.numerics import exact
from nerfreg.scenes.cameras import Cameras

OUTSIDE = torch.tensor([[True, False, True], [False, True, True]])


def test_by_hand(dtype, finite_gradients):
    tau = torch.tensor([[1.0, 2.0, 0.0], [3.0, 0.5, 1.0]], dtype=dtype, requires_grad=True)
    value = outside_opacity(tau, OUTSIDE)
    expected = (3 - 2 * math.exp(-1) - math.exp(-0.5)) / 2
    assert value.item() == pytest.approx(expected, rel=1e-6)
    gradient = finite_gradients(value, tau)[0]
    assert (gradient[~OUTSIDE] == 0).all()
    torch.testing.assert_close(gradient[OUTSIDE], (-tau.detach()[OUTSIDE]).exp() / 2)


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1.0, 50.0])
def test_against_the_reference(dtype, scale):
    draw = torch.Generator().manual_seed(0)
    tau = (scale * torch.rand(5, 7, dtype=torch.float64, generator=draw)).to(dtype)
    outside = torch.rand(5, 7, generator=draw) < 0.5
    with mpmath.workdps(40):
        expected = float(reference.outside_opacity(exact(tau), outside.tolist()))
    tolerance = 1e-6 if dtype == torch.float32 else 1e-14
    assert outside_opacity(tau, outside).item() == pytest.approx(expected, rel=tolerance)


def test_gradcheck():
    tau = torch.rand(2, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    tau.requires_grad_()
    assert torch.autograd.gradcheck(lambda tau: outside_opacity(tau, OUTSIDE), tau)


@pytest.mark.parametrize("thickness", [0.0, 1e30, math.inf])
def test_extreme_thickness(dtype, finite_gradients, thickness):
    tau = torch.full((2, 3), thickness, dtype=dtype, requires_grad=True)
    value = outside_opacity(tau, OUTSIDE)
    assert value.item() == (0 if thickness == 0 else 2)
    finite_gradients(value, tau)


def test_no_rays_and_doubled_rays(dtype):
    tau = torch.rand(2, 3, dtype=dtype, generator=torch.Generator().manual_seed(2))
    assert outside_opacity(tau[:0], OUTSIDE[:0]).item() == 0
    double = outside_opacity(tau.repeat(2, 1), OUTSIDE.repeat(2, 1))
    torch.testing.assert_close(double, outside_opacity(tau, OUTSIDE))


def test_directions_are_spread_evenly():
    normals = directions(400)
    torch.testing.assert_close(normals.norm(dim=1), torch.ones(400))
    assert normals.mean(dim=0).norm() < 0.01
    # No direction is farther from the nearest than the side of a 400th part of the sphere.
    probes = normalize(torch.randn(2000, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    nearest = (probes @ normals.T).amax(dim=1).clamp(max=1).acos()
    assert nearest.max() < math.sqrt(4 * math.pi / 400)


def test_support_of_a_cube_and_a_sphere():
    draw = torch.Generator().manual_seed(0)
    normals = directions(64)
    corners = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3)
    cube = torch.cat([corners, 2 * torch.rand(500, 3, generator=draw) - 1])
    torch.testing.assert_close(support_planes(cube, normals, 1.0), normals.abs().sum(dim=1))
    sphere = normalize(torch.randn(20_000, 3, generator=draw), dim=1) * 0.5
    reach = support_planes(sphere + 0.25, normals, 1.0) - 0.25 * normals.sum(dim=1)
    torch.testing.assert_close(reach, torch.full_like(reach, 0.5), atol=0.002, rtol=0)


def test_the_last_share_of_points_does_not_count():
    # 99 points at 1 to 99, and one mistake.
    points = torch.zeros(100, 3)
    points[:, 0] = torch.arange(1, 101)
    points[-1, 0] = 1e6
    along = torch.tensor([[1.0, 0.0, 0.0]])
    assert support_planes(points, along, 1.0).item() == 1e6
    assert support_planes(points, along, 0.99).item() == 99
    assert support_planes(points, along, 0.985).item() == 99
    assert support_planes(points, along, 0.5).item() == 50
    assert support_planes(points[:1], along, 0.5).item() == 1


def ball(count: int = 40_000, radius: float = 0.5) -> torch.Tensor:
    draw = torch.Generator().manual_seed(0)
    return normalize(torch.randn(count, 3, generator=draw), dim=1) * radius


def known(scale: float = 1.0, **parts: torch.Tensor) -> Photographs:
    """Two photographs of 40 x 40 pixels, from +z and from +x, of a scene of this size."""
    pose = torch.eye(4)[:3]
    front, side = pose.clone(), pose.clone()
    front[2, 3] = 4 * scale
    side[:, :3] = torch.tensor([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    side[0, 3] = 4 * scale
    cameras = Cameras(
        160,
        160,
        torch.stack([front, side]),
        torch.full((2, 2), 400.0),
        torch.full((2, 2), 80.0),
        torch.zeros(2, 5),
    )
    return Photographs(
        images=torch.zeros(2, 160, 160, 3),
        cameras=cameras,
        box=scale * torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]),
        near=0.1 * scale,
        far=10.0 * scale,
        layout="orbit",
        **parts,
    )


def nowhere(points: torch.Tensor) -> torch.Tensor:
    return torch.zeros(len(points), dtype=torch.bool)


def started(photographs: Photographs, step, empty=nowhere, **options: float) -> ConvexPrior:
    plugin = ConvexPrior(**options)
    plugin.nerfreg_module(photographs)
    plugin.nerfreg_prepare(photographs)
    made = step()
    # A field that can tell nothing but what is declared empty.
    names = ("tables", "encode", "density", "density_gradient", "color", "activate")
    others = dict.fromkeys(names, nowhere)
    made.renderer.view = lambda step: SimpleNamespace(**others, empty=empty)
    plugin.nerfreg_start(made)
    return plugin


def outside(plugin: ConvexPrior, positions: torch.Tensor, rendering) -> torch.Tensor:
    """Which positions are penalized, by rays of one sample that begin there."""
    made = rendering(torch.ones(len(positions), 1))
    rays = replace(made.rays, origins=positions, directions=torch.zeros_like(positions))
    found = plugin._outside(replace(made, rays=rays))
    return found[:, 0]


def test_points_of_the_files(step, rendering):
    plugin = started(known(points=ball()), step)
    positions = 2 * torch.rand(20_000, 3, generator=torch.Generator().manual_seed(3)) - 1
    found, radius = outside(plugin, positions, rendering), positions.norm(dim=1)
    # Grown by a 50th of the side of the box, 0.04; a cell is 2 / 96 wide, and there are 400 planes.
    assert not found[radius <= 0.54].any()
    assert found[radius > 0.54 * 1.02 + 2 / 96 * math.sqrt(3)].all()


@pytest.mark.parametrize("kind", ["depth", "known_depth"])
def test_points_of_known_depth(step, rendering, kind):
    made = known()
    depth = torch.full((2, 160, 160), torch.nan)
    for view in range(2):
        origins, ahead = made.cameras.image_rays(view)
        half_b = (origins * ahead).sum(dim=1)
        root = half_b**2 - (origins.square().sum(dim=1) - 0.25)
        depth[view] = torch.where(root > 0, -half_b - root.sqrt(), torch.nan).view(160, 160)
    if kind == "known_depth":
        depth = torch.stack([depth - 0.01, depth + 0.01], dim=-1)
    plugin = started(replace(made, **{kind: depth}), step)
    # Both halves that are seen, and the hull of them, but not the far corner.
    near = 0.49 * normalize(torch.tensor([[1.0, 0.2, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]]), dim=1)
    assert not outside(plugin, near, rendering).any()
    far = torch.tensor([[-0.45, 0.0, -0.45], [0.7, 0.0, 0.0], [0.0, -0.9, 0.0]])
    assert outside(plugin, far, rendering).all()


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scale_of_the_scene(step, rendering, scale):
    positions = 2 * torch.rand(5000, 3, generator=torch.Generator().manual_seed(3)) - 1
    # A power of 2 near the scale: every rounding is the same.
    scale = 2.0 ** round(math.log2(scale))
    plain = outside(started(known(points=ball()), step), positions, rendering)
    scaled = started(known(scale, points=scale * ball()), step)
    assert torch.equal(outside(scaled, scale * positions, rendering), plain)
    assert 0.3 < plain.float().mean() < 0.99
    assert scaled.scale_free


@pytest.mark.parametrize("growth", [0.0, 0.02])
def test_what_is_inside_of_the_planes_is_never_penalized(step, rendering, growth):
    draw = torch.Generator().manual_seed(4)
    # A slanted box, whose faces lie along no cells.
    turn = torch.linalg.qr(torch.randn(3, 3, generator=draw)).Q
    sizes = torch.tensor([0.6, 0.3, 0.1])
    points = (2 * torch.rand(40_000, 3, generator=draw) - 1) * sizes @ turn.T
    plugin = started(known(points=points), step, share=1.0, growth=growth)
    counted = (points @ directions(400).T).amax(dim=0) <= plugin._planes.offsets + 1e-6
    inside = ((points @ directions(400).T) <= plugin._planes.offsets).all(dim=1)
    assert inside.float().mean() > 0.9
    assert growth == 0 or counted.all()
    assert not outside(plugin, points[inside], rendering).any()


def test_mistakes_far_away_do_not_count(step, rendering):
    draw = torch.Generator().manual_seed(5)
    # Single ones, of which no cell holds enough, and outside of the box as many as there are.
    alone = 2 * torch.rand(200, 3, generator=draw) - 1
    away = 5 + torch.rand(5000, 3, generator=draw)
    plain = started(known(points=ball()), step)
    wrong = started(known(points=torch.cat([ball(), alone, away])), step)
    # Few of the first lie in cells that the ball fills.
    change = (wrong._planes.offsets - plain._planes.offsets).abs()
    assert change.max() < 0.01


def test_points_in_empty_space_do_not_count(step, rendering):
    crowd = torch.tensor([0.8, 0.8, 0.8]) + 0.01 * ball(2000)
    points = torch.cat([ball(), crowd])
    at_the_corner = torch.tensor([[0.75, 0.75, 0.75]])
    plugin = started(known(points=points), step)
    assert not outside(plugin, at_the_corner, rendering).any()
    plugin = started(known(points=points), step, lambda points: points.amin(dim=1) > 0.7)
    assert outside(plugin, at_the_corner, rendering).all()


@pytest.mark.parametrize("points", [None, ball(100), ball(5000, radius=1e-3), 10 + ball()])
def test_too_few_points(step, rendering, points):
    with pytest.warns(NerfregWarning, match="does nothing: points are known in") as said:
        plugin = started(known(points=points), step)
    assert len(said) == 1
    made = rendering(torch.ones(2, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert plugin.nerfreg_loss(made) == {}
        assert plugin.nerfreg_reference(made) is None


def test_a_cell_needs_a_few_points(step):
    # 300 cells with one point less than enough are no cells.
    cells = (torch.cartesian_prod(*[torch.arange(7)] * 3)[:300] + 20.5) / 48 - 1
    with pytest.warns(NerfregWarning, match="points are known in 0 cells"):
        started(known(points=cells.repeat(CROWD - 1, 1)), step)
    started(known(points=cells.repeat(CROWD, 1)), step)


def test_loss_and_reference(step, rendering):
    plugin = started(known(points=ball()), step)
    made = rendering(torch.rand(4, 8, generator=torch.Generator().manual_seed(6)))
    # Rays along -z from z = 3: they end at -3, and what is inside lies in the middle.
    rays = replace(made.rays, origins=torch.tensor([0.0, 0.0, 4.0]).expand(4, 3))
    made = replace(made, rays=rays)
    found = plugin._outside(made)
    assert found.any() and not found.all()
    term = plugin.nerfreg_loss(made)["convex"]
    assert term.item() == pytest.approx((-torch.expm1(-made.tau))[found].sum().item() / 4)
    with mpmath.workdps(30):
        expected = plugin.nerfreg_reference(made)["convex"]
    assert term.item() == pytest.approx(float(expected), rel=1e-6)


def test_planes_that_are_restored_replace_those_in_use(step, rendering):
    positions = 2 * torch.rand(5000, 3, generator=torch.Generator().manual_seed(3)) - 1
    small, large = (started(known(points=ball(radius=r)), step) for r in (0.3, 0.7))
    before = outside(small, positions, rendering)
    assert not torch.equal(before, outside(large, positions, rendering))
    small._planes.load_state_dict(large._planes.state_dict())
    assert torch.equal(outside(small, positions, rendering), outside(large, positions, rendering))
    # Neither another device nor another precision keeps the old ones, and what is unknown again
    # is not known from before.
    small._planes.to(torch.float64)
    small._planes.offsets.fill_(torch.inf)
    assert small.nerfreg_loss(rendering(torch.ones(2, 3))) == {}


@pytest.mark.parametrize("others", [(), ("+reg=[silhouettes,convex_prior]",)])
def test_a_run_with_and_without_silhouettes(make, others):
    sizes = ("scene.size=48", "scene.views=4", "train.rays=512")
    words = others or ("+reg=convex_prior",)
    own = ("reg.convex_prior.weight={schedule: linear, from: 0.001, to: 0.1}",)
    with warnings.catch_warnings():
        # No file and no plugin knows any points of this scene.
        warnings.simplefilter("ignore", NerfregWarning)
        trainer = make(*words, *sizes, *own)
    plugin = trainer.hooks.plugins["convex_prior"]
    assert not [term for term in trainer.step() if term.plugin == "convex_prior"]
    plugin._planes.offsets.fill_(0.2)
    weights = []
    for _ in range(3):
        terms = [term for term in trainer.step() if term.plugin == "convex_prior"]
        weights += [term.weight for term in terms]
        assert all(term.value.isfinite() and term.value > 0 for term in terms)
    assert weights == sorted(weights) and len(set(weights)) == len(weights) > 1


@pytest.mark.parametrize("option", [{"planes": 3}, {"share": 0.4}, {"growth": -1.0}])
def test_values_out_of_range(option):
    with pytest.raises(NerfregError, match=rf"reg\.convex_prior\.{next(iter(option))}="):
        ConvexPrior(**option)
