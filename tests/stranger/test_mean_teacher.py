"""A mean teacher, a package of a stranger: unseen rays, the averaged field, state of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from nerfreg.hooks import Needs
from nerfreg.registry import Hooks
from nerfreg.runs.load import load_trained
from nerfreg.runs.train import train
from nerfreg.scenes import load_scene
from nerfreg.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("gallery")
BUDGET = (
    "train.steps=60", "scene.views=4", "optim.ema=0.98", "field.hidden=32",
    "reg.mean_teacher.warmup=10",
)  # fmt: skip


def disagreement(trainer: Trainer) -> float:
    """Mean squared difference of colours between student and teacher on the same unseen rays."""
    generator = torch.Generator().manual_seed(7)
    trainer.batches.generator = generator
    step = replace(trainer._step(), generator=generator)
    rays = trainer.batches.draw(Needs(unseen_rays=0.9))
    with torch.no_grad():
        student = step.render(rays.picked(rays.unseen))
        return float((student.rgb - step.teacher.rerender(student).rgb).square().mean())


def test_student_and_teacher_come_to_agree_on_unseen_views(make) -> None:
    found = []
    for weight in (1e-9, 100.0):
        trainer = make("+reg=mean_teacher", *BUDGET, f"reg.mean_teacher.weight={weight}")
        while trainer.budget.step < 60:
            trainer.step()
        found.append(disagreement(trainer))
    assert found[1] < 0.7 * found[0]


def test_teaches_a_quarter_of_the_rays_and_learns_nothing_from_the_student(make) -> None:
    trainer = make("+reg=mean_teacher", "reg.mean_teacher.warmup=1")
    for _ in range(3):
        terms = trainer.step()
    assert [term.plugin for term in terms] == ["color", "mean_teacher"]
    assert terms[1].value > 0
    before = [average.clone() for average in trainer.average.averages]
    step = trainer._step()
    needs = trainer.hooks.needs(step)
    rendering = step.render(trainer.batches.draw(needs))
    assert len(rendering.rays.unseen) == len(rendering.rays) // 4
    trainer.field.zero_grad()
    (term,) = trainer.hooks.losses(rendering, step)
    term.value.backward()
    # What the teacher is made of stays as it is, and has no gradient.
    for average, value in zip(trainer.average.averages, before, strict=True):
        assert torch.equal(average, value)
    assert trainer.field.density_network.layers[0].weight.grad.abs().max() > 0


def test_state_survives_a_checkpoint(compose, tmp_path: Path) -> None:
    config = compose(
        "+reg=mean_teacher", "scene.size=8", "scene.views=2", "scene.test_views=1",
        "field.levels=2", "field.log2_entries=8", "train.steps=5", "train.rays=16",
        "train.quiet=true", "eval.lpips=false", "eval.count=1",
    )  # fmt: skip
    train(config, tmp_path)
    plugin = config.reg["mean_teacher"]
    hooks = Hooks(config.reg).fresh()
    load_trained(tmp_path, config, load_scene(config.scene), hooks, torch.device("cpu"))
    restored = hooks.plugins["mean_teacher"]
    assert restored is not plugin
    assert restored.state_dict() == plugin.state_dict()
    assert restored.state_dict()["steps"] == 5
    assert restored.state_dict()["usual"] > 0
