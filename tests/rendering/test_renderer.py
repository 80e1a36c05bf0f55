"""The renderer against compositing by hand, and what the hooks may rely on."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from nerfreg.field import FieldConfig, RadianceField
from nerfreg.field.directions import spherical_harmonics
from nerfreg.field.layers import Linear
from nerfreg.hooks import Rays, Samples, Step
from nerfreg.registry import Hooks
from nerfreg.rendering.compositing import composite
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.renderer import Renderer

BOX = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])


@pytest.fixture
def field() -> RadianceField:
    torch.manual_seed(0)
    config = FieldConfig(levels=4, base=4, finest=16, log2_entries=10, hidden=16, geometry=7)
    field = RadianceField(
        config, BOX, lambda network, index, i, o, activation: Linear(i, o, activation)
    )
    torch.nn.init.uniform_(field.grid.table, -3, 3)
    return field


def some_rays(count: int = 6, groups: Tensor | None = None) -> Rays:
    origins = torch.tensor([[0.0, 0.0, 3.0]]) + 0.1 * torch.randn(count, 3)
    directions = torch.nn.functional.normalize(
        torch.tensor([0.0, 0.0, -1.0]) + 0.1 * torch.randn(count, 3), dim=-1
    )
    near, far = torch.full((count,), 2.0), torch.full((count,), 4.0)
    return Rays(
        origins, directions, near, far, torch.rand(count, 3), torch.rand(count, 3), groups=groups
    )


def a_step(seed: int = 0) -> Step:
    return Step(
        0,
        10,
        0.0,
        torch.Generator().manual_seed(seed),
        (2.0, 4.0),
    )


def test_a_rendering_is_the_composite_of_the_field_at_its_samples(field: RadianceField) -> None:
    rays = some_rays()
    rendering = Renderer(field, SamplerConfig(8, 16), Hooks()).render(rays, a_step())
    assert rendering.t.shape == (6, 24) and (rendering.t.diff(dim=1) >= 0).all()
    assert (
        (rendering.t_edges[:, :-1] <= rendering.t) & (rendering.t <= rendering.t_edges[:, 1:])
    ).all()
    points = rays.origins[:, None] + rays.directions[:, None] * rendering.t[..., None]
    raw = field.raw_density(points.view(-1, 3))
    harmonics = spherical_harmonics(rays.directions).repeat_interleave(24, dim=0)
    color = field.color(raw, harmonics).view(6, 24, 3)
    expected = composite(field.density(raw).view(6, 24), color, rendering.t_edges, rays.background)
    torch.testing.assert_close(rendering.weights, expected.weights)
    torch.testing.assert_close(rendering.depth, expected.depth)
    # colours of samples with weight below 1e-4 are left out, 24 of them at most
    torch.testing.assert_close(rendering.rgb, expected.rgb, rtol=0, atol=24e-4)


def test_gradients_are_those_of_the_plain_composite(field: RadianceField) -> None:
    rays = some_rays()
    rendering = Renderer(field, SamplerConfig(8, 16), Hooks()).render(rays, a_step())
    (rendering.rgb.sum() + rendering.depth.sum()).backward()
    fused = {name: p.grad.clone() for name, p in field.named_parameters() if p.grad is not None}
    field.zero_grad()
    points = rays.origins[:, None] + rays.directions[:, None] * rendering.t[..., None]
    raw = field.raw_density(points.view(-1, 3))
    color = field.color(
        raw, spherical_harmonics(rays.directions).repeat_interleave(24, dim=0)
    ).view(6, 24, 3)
    color = color * rendering.colored[..., None]
    plain = composite(field.density(raw).view(6, 24), color, rendering.t_edges, rays.background)
    assert plain.rgb is not None
    (plain.rgb.sum() + plain.depth.sum()).backward()
    for name, parameter in field.named_parameters():
        assert parameter.grad is not None
        scale = float(parameter.grad.abs().max())
        torch.testing.assert_close(fused[name], parameter.grad, rtol=1e-4, atol=1e-5 * scale)


def test_rays_of_a_group_share_their_t(field: RadianceField) -> None:
    groups = torch.tensor([0, 1, 1, 2, 1, 0])
    rays = some_rays(groups=groups)
    rays.near[2], rays.far[4] = 1.5, 4.5
    rendering = Renderer(field, SamplerConfig(8, 16), Hooks()).render(rays, a_step())
    for group in range(3):
        members = rendering.t_edges[groups == group]
        assert torch.equal(members, members[:1].expand_as(members))
    assert (
        rendering.t_edges[1, 0] == 1.5 and rendering.t_edges[1, -1] == 4.5
    )  # nearest and farthest of the group
    assert not torch.equal(rendering.t[0], rendering.t[3])


def test_rerendering_repeats_the_rendering(field: RadianceField) -> None:
    renderer = Renderer(field, SamplerConfig(8, 16), Hooks())
    rendering = renderer.render(some_rays(), a_step())
    again = renderer.render(rendering.rays, a_step(1), like=rendering)
    assert torch.equal(again.t, rendering.t) and torch.equal(again.colored, rendering.colored)
    torch.testing.assert_close(again.rgb, rendering.rgb)


def test_encoder_input_is_asked_for_every_evaluation(field: RadianceField) -> None:
    class Watcher(Hooks):
        seen: list[tuple[int, ...]] = []  # noqa: RUF012

        def encoder_input(self, samples: Samples, step: Step) -> Samples:
            self.seen.append(tuple(samples.t.shape))
            return samples

    renderer = Renderer(field, SamplerConfig(8, 16), Watcher())
    rendering = renderer.render(some_rays(), a_step())
    renderer.render(rendering.rays, a_step(), like=rendering)
    assert Watcher.seen == [(6, 8), (6, 16), (6, 24)]
    assert renderer.points == 6 * 48


def test_directions_that_differ_along_a_ray_follow_their_samples(field: RadianceField) -> None:
    """Given sample by sample, directions that are the same along a ray change nothing."""

    class PerSample(Hooks):
        def encoder_input(self, samples: Samples, step: Step) -> Samples:
            directions = samples.directions[:, None].expand(*samples.t.shape, 3)
            # Near samples see another direction than far ones, so that their order matters.
            turned = torch.where(samples.t[..., None] < self.split, -directions, directions)
            return replace(samples, directions=turned)

    rays = some_rays()
    expected = Renderer(field, SamplerConfig(8, 16), Hooks()).render(rays, a_step())
    hooks = PerSample()
    hooks.split = 0.0
    same = Renderer(field, SamplerConfig(8, 16), hooks).render(rays, a_step())
    torch.testing.assert_close(same.rgb, expected.rgb)
    hooks.split = 3.0
    turned = Renderer(field, SamplerConfig(8, 16), hooks).render(rays, a_step())
    again = Renderer(field, SamplerConfig(8, 16), hooks).render(rays, a_step(), like=turned)
    assert not torch.allclose(turned.rgb, expected.rgb)
    torch.testing.assert_close(again.rgb, turned.rgb)


def test_rays_that_miss_the_box_are_their_background(field: RadianceField) -> None:
    rays = some_rays()
    rays.far[:] = rays.near
    rendering = Renderer(field, SamplerConfig(8, 16), Hooks()).render(rays, a_step())
    assert rays.background is not None
    torch.testing.assert_close(rendering.rgb, rays.background)
    assert torch.equal(rendering.depth, rays.far) and not rendering.visible.any()
    rendering.rgb.sum().backward()
    for parameter in field.parameters():
        assert parameter.grad is None or torch.isfinite(parameter.grad).all()


def test_log_weights_are_the_logarithm_of_the_weights(field: RadianceField) -> None:
    rendering = Renderer(field, SamplerConfig(8, 16), Hooks()).render(some_rays(), a_step())
    torch.testing.assert_close(rendering.log_weights.exp(), rendering.weights, rtol=1e-4, atol=1e-9)
    torch.testing.assert_close(
        rendering.alphas, 1 - torch.exp(-rendering.tau), rtol=1e-3, atol=1e-6
    )
    assert math.isfinite(rendering.opacity.sum().item())
