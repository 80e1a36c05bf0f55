"""The package normals: the surface of a plane gets smooth."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

from nerfreg import Needs
from nerfreg.scenes.scene import Scene
from nerfreg.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("gallery")
STEPS = 25
OWN = ("+reg=normals", "reg.normals.weight=1")


def plane(scene: Scene) -> Scene:
    """The same cameras, which look at a chequered square in the plane z = 0."""

    @cache
    def read_image(view: int) -> Tensor:
        origins, directions = scene.cameras.image_rays(view)
        points = origins - directions * (origins[:, 2:] / directions[:, 2:])
        inside = points[:, :2].abs().amax(dim=1) < 1
        waves = (points[:, :2] * 12).sin().prod(dim=1).sign()
        colors = 0.5 + waves[:, None] * torch.tensor([0.4, 0.2, -0.3])
        image = torch.cat([colors, inside[:, None].float()], dim=1)
        return image.view(scene.cameras.height, scene.cameras.width, 4)

    return replace(scene, read_image=read_image, read_depth=None)


def normals_seen(trainer: Trainer) -> Tensor:
    """Normals where rays meet the surface."""
    torch.manual_seed(0)
    trainer.batches.count = 1024
    step = trainer._step()
    rays = trainer.batches.draw(Needs())
    with torch.no_grad():
        rendering = trainer.renderer.render(rays, step)
    points = (rays.origins + rays.directions * rendering.depth[:, None])[rendering.opacity > 0.5]
    assert len(points) > 100
    return normals_at(trainer, points)


def normals_at(trainer: Trainer, points: Tensor) -> Tensor:
    """The directions in which the density falls, by differences over a thousandth of the box."""
    tiny = 1e-3 * trainer.scene.info.half_box
    ends = points[:, None, None] + tiny * torch.stack([torch.eye(3), -torch.eye(3)], dim=1)
    with torch.no_grad():
        density = trainer._step().field.density(ends.flatten(0, 2)).log().view(-1, 3, 2)
    return normalize(density[..., 1] - density[..., 0], dim=1)


def roughness(trainer: Trainer) -> float:
    """How far normals point apart: 0 where all agree, 1 where they point anywhere."""
    return 1 - float(normals_seen(trainer).mean(dim=0).norm())


def fit_rough_plane(trainer: Trainer) -> None:
    """Fit the density to a half-space below z = 0, with waves that turn its normals."""
    field, generator = trainer.field, torch.Generator().manual_seed(0)
    optimizer = torch.optim.Adam(field.parameters(), lr=1e-2)
    low, high = trainer.scene.box
    for _ in range(60):
        points = torch.lerp(low, high, torch.rand(2048, 3, generator=generator))
        waves = (points * 25).sin().prod(dim=1)
        target = 4 * torch.tanh((-points[:, 2] + 0.05 * waves) / 0.1)
        loss = (field.raw_density(points)[:, 0] - target).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()


def test_normals_of_a_plane_get_smooth(make) -> None:
    vanilla, smooth = make(change=plane), make(*OWN, change=plane)
    for trainer in (vanilla, smooth):
        fit_rough_plane(trainer)
    assert roughness(smooth) == roughness(vanilla) > 0.4
    for _ in range(STEPS):
        vanilla.step()
        smooth.step()
    assert roughness(smooth) < 0.7 * roughness(vanilla)
    # They point up, out of the plane.
    assert normals_seen(smooth).mean(dim=0)[2] > 0.4 > normals_seen(vanilla).mean(dim=0)[2]


def test_term_is_what_differences_of_the_density_say(make) -> None:
    trainer = make(*OWN, "reg.normals.rays=1000", "reg.normals.radius=0.05", change=plane)
    fit_rough_plane(trainer)
    step = trainer._step()
    rendering = trainer.renderer.render(trainer.batches.draw(Needs()), step)
    state = step.generator.get_state()
    [term] = trainer.hooks.losses(rendering, step)
    step.generator.set_state(state)
    hits = rendering.visible.nonzero().squeeze(1)
    hits = hits[torch.randperm(len(hits), generator=step.generator)]
    rays, depth = rendering.rays, rendering.depth.detach()[hits, None]
    surface = rays.origins[hits] + rays.directions[hits] * depth
    shift = torch.randn(len(hits), 3, generator=step.generator)
    shift = trainer.scene.info.half_box * 0.05 * shift
    here, there = normals_at(trainer, surface + shift), normals_at(trainer, surface - shift)
    expected = (here - there).square().sum(dim=1)
    assert term.value.item() == pytest.approx(expected.mean().item(), rel=0.05)


def test_nothing_to_see_costs_nothing(make) -> None:
    trainer = make(*OWN)
    trainer.field.bias = -60.0
    assert trainer.step()[1].value.item() == 0
    assert trainer.guard.skipped == 0
