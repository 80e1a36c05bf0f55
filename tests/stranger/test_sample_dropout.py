"""The package sample_dropout: what it leaves out in training, and nothing in evaluation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from nerfreg.evaluation.leaks import require_no_leak
from nerfreg.evaluation.trained import TrainedField, evaluated
from nerfreg.hooks import DensitySamples
from nerfreg.registry import Hooks
from nerfreg.runs.load import load_trained
from nerfreg.training.checkpoint import State, save_checkpoint
from nerfreg.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("gallery")
SMALL = (
    "scene.size=24", "scene.views=3", "scene.test_views=1", "field.levels=4", "field.finest=64",
    "field.log2_entries=12",
)  # fmt: skip

QUICK = ("sampler.skip_resolution=16", "sampler.view_samples=32", "sampler.scout_samples=32")


def pictures(trained: TrainedField) -> Tensor:
    view = trained.renderer().view(trained.scene.cameras, trained.scene.test[0])
    return torch.cat([view.rgb, view.depth[..., None], view.opacity[..., None]], dim=-1)


def from_checkpoint(trainer: Trainer, compose, folder: Path, *overrides: str) -> TrainedField:
    with trainer.average.applied():
        save_checkpoint(folder, trainer.field, State(trainer.budget.step, 0.0, 0, 0))
    config = compose(*SMALL, *overrides)
    config = replace(config, sampler=trainer.renderer.sampler)
    device = torch.device("cpu")
    return load_trained(folder, config, trainer.scene, Hooks(config.reg), device)[1]


def dropped(make, *overrides: str, index: int = 100) -> tuple[Tensor, Tensor]:
    """What becomes of densities of 1 at random samples, and their places in the unit cube."""
    trainer = make("+reg=sample_dropout", "train.steps=100", *overrides)
    rays = trainer.batches.draw(trainer.hooks.needs(trainer._step()))
    step = replace(trainer._step(), index=index, total=100, fraction=index / 100)
    share = torch.linspace(0, 1, 65)
    edges = torch.lerp(rays.near[:, None], rays.far[:, None], share)
    t = (edges[:, 1:] + edges[:, :-1]) / 2
    samples = DensitySamples(rays, t, edges, torch.ones_like(t), lambda: torch.zeros_like(t))
    return trainer.hooks.density(samples, step), trainer.scene.info.unit(samples.positions)


@pytest.mark.parametrize("cells", [0, 16])
def test_optical_thickness_stays_the_same_on_average(make, cells: int) -> None:
    for index, rate in ((0, 0.0), (50, 0.2), (100, 0.4)):
        own = ("reg.sample_dropout.rate=0.4", f"reg.sample_dropout.cells={cells}")
        density, _ = dropped(make, *own, index=index)
        kept = density > 0
        torch.testing.assert_close(density[kept], torch.full_like(density[kept], 1 / (1 - rate)))
        # 8192 samples; of 16^3 cells, some hundred are met.
        assert float((~kept).float().mean()) == pytest.approx(rate, abs=0.08 if cells else 0.03)


def test_cells_are_left_out_as_a_whole(make) -> None:
    density, places = dropped(make, "reg.sample_dropout.rate=0.5", "reg.sample_dropout.cells=8")
    x, y, z = (places * 8).long().clamp(0, 7).unbind(-1)
    cell = (x + 8 * (y + 8 * z)).flatten()
    zeros = torch.zeros(512)
    total = zeros.scatter_add(0, cell, density.flatten())
    count = zeros.scatter_add(0, cell, torch.ones(len(cell)))
    met = count > 0
    fate = total[met] / count[met]
    assert set(fate.tolist()) == {0.0, 2.0}
    assert int((count > 10).sum()) > 50


def test_changes_training(make) -> None:
    vanilla, plain, whole = (
        make(*own)
        for own in (
            (),
            ("+reg=sample_dropout",),
            ("+reg=sample_dropout", "reg.sample_dropout.cells=16"),
        )
    )
    weights = []
    for trainer in (vanilla, plain, whole):
        for _ in range(3):
            trainer.step()
        weights.append(trainer.field.grid.table.detach().clone())
    assert not torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


def test_evaluation_right_after_a_step_is_that_of_the_checkpoint(
    make, compose, tmp_path: Path
) -> None:
    """Within the window, and after it has closed; and the training does not notice."""
    own = ("+reg=sample_dropout", "reg.sample_dropout.rate=0.9", "reg.sample_dropout.end=0.5")
    trainer, unseen = (make(*own, *QUICK, "train.steps=8") for _ in range(2))
    seen = []
    for index in range(6):
        trainer.step()
        unseen.step()
        if index not in (2, 5):
            continue
        with evaluated(trainer) as live:
            fresh = from_checkpoint(trainer, compose, tmp_path, *own)
            require_no_leak(live, fresh)
            seen.append(pictures(live))
            assert torch.equal(seen[-1], pictures(fresh))
            # Without the plugin, the same weights look the same.
            assert torch.equal(seen[-1], pictures(replace(live, hooks=Hooks())))
    assert not torch.equal(*seen)
    assert torch.equal(trainer.field.grid.table, unseen.field.grid.table)
