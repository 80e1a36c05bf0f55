"""Checks of a whole small run: a real scene, field and trainer, a checkpoint, an evaluation."""

from __future__ import annotations

import tempfile
from functools import cache, partial
from pathlib import Path

import torch
from torch import nn

from nerfreg.checks.report import Report, in_words
from nerfreg.checks.restoration import unsaved_parameters, wrong_restoration
from nerfreg.checks.steps import RunCase
from nerfreg.checks.watch import FOUND_OUT, WatchedHooks, core_weights
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError, PluginError
from nerfreg.evaluation.leaks import require_no_leak
from nerfreg.evaluation.scores import score_views
from nerfreg.evaluation.trained import TrainedField
from nerfreg.field import FieldConfig
from nerfreg.registry import Hooks
from nerfreg.rendering.config import SamplerConfig
from nerfreg.runs.load import load_trained
from nerfreg.scenes import Scene
from nerfreg.scenes.procedural import Procedural
from nerfreg.training import TrainConfig
from nerfreg.training.checkpoint import State, save_checkpoint
from nerfreg.training.contracts_setup import wrong_state
from nerfreg.training.guard import Guard
from nerfreg.training.trainer import Trainer

RUN_CASE = RunCase("run", "a small run: 20 steps, a checkpoint, an evaluation from it")
STEPS = 20
CPU = torch.device("cpu")

CONFIG = Config(
    field=FieldConfig(levels=4, base=4, finest=32, log2_entries=10, hidden=16, geometry=7),
    sampler=SamplerConfig(coarse=8, fine=8, skip_resolution=16, view_samples=16, scout_samples=16),
    train=TrainConfig(steps=STEPS, rays=256, quiet=True),
)
"""Enough rays for patches of 8 x 8 pixels; everything else as small as it can be."""


@cache
def _scene() -> Scene:
    return Procedural(size=16, views=3, test_views=1).load()


def check_run(report: Report, case: RunCase, _: None) -> None:
    """Check that a run trains, saves and restores, and evaluates as a fresh process would."""
    own = report.subject.configured()
    # With its own weight, at which a run is meant to train, and all the time.
    hooks = WatchedHooks(report.subject.selected(weight=own.weight or 1.0))
    lines: list[str] = []
    try:
        trainer = _trainer(hooks, lines)
    except PluginError:
        raise
    except NerfregError as error:
        for check in ("run", "state"):
            report.skip(check, str(error))
        return
    hooks.weights = core_weights([*trainer.field.named_children()])
    try:
        for _step in range(STEPS):
            trainer.step()
        trainer.end()
    except Exception as error:  # a foreign plugin may raise anything
        lines.append(f"{in_words(error)}, at step {trainer.budget.step}")
    report.judge("run", lines)
    report.judge("run", _not_finite_weights(trainer.field))
    plugin = hooks.plugins[report.subject.name]
    wrong = [*wrong_state(plugin.state_dict()), *unsaved_parameters(plugin, trainer.field)]
    report.judge("state", wrong)
    if not lines and not wrong:
        with tempfile.TemporaryDirectory() as folder:
            with report.at(report.spot, "run"):
                report.judge("run", _leaks(trainer, Path(folder)))
            with report.at(report.spot, "state"):
                other = _trainer(hooks.fresh(), lines)
                report.judge("state", wrong_restoration(trainer, other, Path(folder)))
    report.judge("contract", hooks.fallen_silent(FOUND_OUT))
    for check in ("contract", "effects"):
        report.judge(check, hooks.take(check))


def _trainer(hooks: Hooks, lines: list[str]) -> Trainer:
    with torch.random.fork_rng(devices=[]):
        return Trainer(
            _scene(),
            hooks,
            CONFIG.field,
            CONFIG.sampler,
            CONFIG.optim,
            CONFIG.train,
            guard=Guard(report=lines.append),
        )


def _not_finite_weights(field: nn.Module) -> list[str]:
    return [
        f"weights are not finite after {STEPS} steps: {name}"
        for name, weight in field.named_parameters()
        if not bool(weight.isfinite().all())
    ]


def _leaks(trainer: Trainer, folder: Path) -> list[str]:
    """Whether an evaluation right after the training is that of the checkpoint."""
    with trainer.evaluated() as step:
        _save(trainer, folder)
        live = TrainedField(
            trainer.field, trainer.hooks, step, trainer.renderer.sampler, trainer.scene
        )
        fresh = trainer.hooks.fresh()
        _, saved = load_trained(folder, CONFIG, trainer.scene, fresh, CPU)
        try:
            require_no_leak(live, saved)
        except PluginError as error:
            return [f"evaluation leak: {str(error).partition(': ')[2]}"]
        # For the hooks of an evaluation, and for metrics of the plugin's own.
        scene, renderer = trainer.scene, live.renderer()
        cameras = scene.cameras
        view = partial(renderer.view, cameras)
        score_views(scene, scene.test, view, lpips=None, measure=live.measure)
    return []


def _save(trainer: Trainer, folder: Path) -> None:
    budget = trainer.budget
    points, skipped = trainer.renderer.points, trainer.guard.skipped
    state = State(
        budget.step, budget.seconds, points, skipped, budget.fraction, trainer.hooks.state_dict()
    )
    save_checkpoint(folder, trainer.field, state)
