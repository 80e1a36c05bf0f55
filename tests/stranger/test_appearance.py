"""Appearance embeddings, a package of a stranger: photographs of different exposures."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from nerfreg.evaluation.scores import score_views
from nerfreg.evaluation.trained import evaluated
from nerfreg.hooks import ColorSamples, Rays
from nerfreg.scenes import Scene
from nerfreg.training.trainer import Trainer

EXPOSURES = (0.7, 1.3)
SCENE = (
    "scene.size=32", "scene.views=30", "scene.test_views=3", "train.rays=512", "train.steps=150",
    "sampler.coarse=16", "sampler.fine=16", "sampler.skip_resolution=24", "field.levels=5",
    "field.base=8", "field.finest=64", "field.log2_entries=12", "field.hidden=32",
)  # fmt: skip
pytestmark = pytest.mark.usefixtures("gallery")


def exposed(scene: Scene) -> Scene:
    """Every second training view has 30 % less light, the others have 30 % more."""
    exposure = {view: EXPOSURES[place % 2] for place, view in enumerate(scene.train)}

    def read_image(view: int) -> Tensor:
        image = scene.read_image(view)
        light = exposure.get(view, 1.0)
        # At most 1 after that, so that no highlight is lost.
        return torch.cat([image[..., :3] * light / max(EXPOSURES), image[..., 3:]], dim=-1)

    return replace(scene, read_image=read_image)


def trained(trainer: Trainer) -> tuple[float, float]:
    """PSNR over the training and over the test views after all steps."""
    scene = trainer.scene
    while trainer.budget.fraction < 1:
        trainer.step()
    with evaluated(trainer) as field:
        renderer = field.renderer()
        render = lambda view: renderer.view(scene.cameras, view)  # noqa: E731
        train, test = (
            score_views(scene, views, render, None).psnr for views in (scene.train, scene.test)
        )
    return train, test


def test_fits_exposures_that_vanilla_cannot(make) -> None:
    vanilla = trained(make(*SCENE, change=exposed))
    embedded = trained(make(*SCENE, "+reg=appearance", change=exposed))
    assert embedded[0] > vanilla[0] + 1
    assert embedded[1] > vanilla[1] + 0.5


def test_other_views_have_the_mean_of_all_vectors(make) -> None:
    trainer = make("+reg=appearance", "reg.appearance.features=3")
    vectors = trainer.field.plugins["appearance"].weight.detach()
    assert vectors.shape == (3, 3)
    rays = Rays(*torch.ones(2, 4, 3), *torch.ones(2, 4), view=torch.tensor([2, -1, 0, -1]))
    samples = ColorSamples(rays, torch.tensor([1, 0, 0, 2]), torch.ones(4))
    found = trainer.hooks.color_input(samples, trainer._step())
    mean = vectors.sum(dim=0) / 3
    torch.testing.assert_close(found, torch.stack([mean, vectors[2], vectors[2], vectors[0]]))
