"""A visual hull, a package of a stranger: what no silhouette contains is never evaluated."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from nerfreg import NerfregError
from nerfreg.hooks import Needs
from nerfreg.scenes import Scene
from nerfreg.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("gallery")


def empty(trainer: Trainer, positions: Tensor) -> Tensor:
    return trainer.hooks.empty(positions, trainer._step())


def test_keeps_all_surfaces_and_leaves_out_most_of_space(make) -> None:
    trainer = make(
        "+reg=hull",
        "reg.hull.resolution=48",
        "scene.views=8",
        "scene.test_views=4",
        "scene.size=48",
    )
    scene = trainer.scene
    for view in (*scene.train, *scene.test):
        origins, directions = scene.cameras.image_rays(view)
        depth = scene.read_depth(view).flatten()
        hit = depth.isfinite()
        assert hit.any()
        # Slightly inside of the surface, which may lie on the border of two cells.
        surface = origins + directions * (depth[:, None] + 1e-3)
        outside = empty(trainer, surface[hit])
        # Training views see a pixel as transparent or not by one point in it; test views see
        # what lies between.
        assert outside.float().mean() < 0.002
    low, high = scene.box
    anywhere = low + (high - low) * torch.rand(10000, 3)
    assert empty(trainer, anywhere).float().mean() > 0.5


def test_spends_all_samples_inside(make) -> None:
    sizes = ("scene.views=8", "scene.size=48", "train.steps=3")
    hull = ("+reg=hull", "reg.hull.resolution=48", "sampler.inside=1")
    plain, carved = make(*sizes), make(*sizes, *hull)
    for trainer in (plain, carved):
        for _ in range(3):
            trainer.step()
    assert len(carved.batches.pixels) < len(plain.batches.pixels)
    # As many as without the hull, since no ray is drawn that meets none of it.
    assert 0.99 * plain.renderer.points < carved.renderer.points <= plain.renderer.points
    step = carved._step()
    rendering = step.render(carved.batches.draw(Needs()))
    positions = rendering.rays.origins[:, None] + (
        rendering.rays.directions[:, None] * rendering.t[..., None]
    )
    outside = empty(carved, positions.view(-1, 3)).view(rendering.t.shape)
    assert not rendering.density[outside].any()
    # Gaps are outside, and places without length fill up rays with fewer gaps than others.
    sampled = ~outside & (rendering.t_edges.diff(dim=1) > 0)
    assert (rendering.density[sampled] > 0).all()
    assert (sampled.sum(dim=1) >= 31).float().mean() > 0.99
    lengths = (rendering.t_edges.diff(dim=1) * sampled).sum(dim=1)
    assert (lengths.mean() / (rendering.rays.far - rendering.rays.near).mean()) < 0.6


def test_hull_is_part_of_the_checkpoint(make) -> None:
    trainer = make("+reg=hull", "reg.hull.resolution=48", "scene.views=8", "scene.size=48")
    fresh = make("+reg=hull", "reg.hull.resolution=48", "scene.views=8", "scene.size=48")
    everything = torch.ones_like(fresh.field.plugins["hull"].occupied)
    fresh.field.plugins["hull"].occupied.copy_(everything)
    fresh.field.load_state_dict(trainer.field.state_dict())
    positions = torch.rand(1000, 3) - 0.5
    assert torch.equal(empty(fresh, positions), empty(trainer, positions))


def test_needs_silhouettes(make) -> None:
    def opaque(scene: Scene) -> Scene:
        read = scene.read_image
        return replace(scene, read_image=lambda view: read(view)[..., :3], has_alpha=False)

    with pytest.raises(NerfregError, match=r"reg\.hull: the photographs have no alpha channel"):
        make("+reg=hull", "reg.hull.resolution=48", change=opaque)
