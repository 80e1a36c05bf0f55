"""FreeNeRF's encoding, a package of a stranger: sines in place of the grid, unmasked in turn."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from nerfreg.evaluation.scores import score_views
from nerfreg.evaluation.trained import evaluated
from nerfreg.training.trainer import Trainer

SCENE = (
    "scene.size=48", "scene.views=8", "scene.test_views=2", "train.rays=256", "train.steps=100",
    "sampler.coarse=16", "sampler.fine=16", "sampler.skip_resolution=32", "field.levels=8",
    "field.finest=256", "field.log2_entries=14",
)  # fmt: skip
pytestmark = pytest.mark.usefixtures("gallery")


def trained(trainer: Trainer) -> float:
    """PSNR over the test views after all steps."""
    scene = trainer.scene
    while trainer.budget.fraction < 1:
        trainer.step()
    with evaluated(trainer) as field:
        renderer = field.renderer()
        render = lambda view: renderer.view(scene.cameras, view)  # noqa: E731
        return score_views(scene, scene.test, render, None).psnr


def test_encodes_by_sines_and_cosines(make) -> None:
    field = make("+reg=freenerf", "reg.freenerf.frequencies=2").field
    assert field.grid is None
    x = torch.tensor([[0.5, 0.75, 0.1]])  # 0, 0.5 and -0.8 in [-1, 1]
    p = math.pi
    expected = [0, 0.5, -0.8]
    for k in (1, 2):
        expected += [0, math.sin(k * p / 2), -math.sin(0.8 * k * p)]
        expected += [1, math.cos(k * p / 2), math.cos(0.8 * k * p)]
    torch.testing.assert_close(field.encoder(x), torch.tensor([expected]))


def test_mask_opens_over_the_run_in_training_and_in_evaluation(make) -> None:
    trainer = make("+reg=freenerf", "reg.freenerf.frequencies=2", "reg.freenerf.duration=0.5")
    positions = torch.rand(20, 3)
    for fraction, alive in ((0.0, 3), (0.125, 6), (0.25, 9), (0.5, 15), (1.0, 15)):
        for training in (True, False):
            step = replace(trainer._step(), fraction=fraction, training=training)
            seen = step.field.encode(positions).abs().amax(dim=0) > 0
            assert seen.tolist() == [True] * alive + [False] * (15 - alive)


def test_trains_nearly_as_well_as_the_grid_at_equal_steps(make) -> None:
    grid = trained(make(*SCENE))
    waves = trained(make(*SCENE, "+reg=freenerf"))
    assert grid > 17  # a grey image has 13 dB
    assert waves > grid - 1.5
