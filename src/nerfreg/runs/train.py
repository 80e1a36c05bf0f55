"""One run from beginning to end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from nerfreg.config.schema import Config
from nerfreg.errors import NonFiniteError
from nerfreg.evaluation.config import subset_of
from nerfreg.evaluation.leaks import require_no_leak
from nerfreg.evaluation.lpips import LPIPS, load_lpips
from nerfreg.evaluation.scores import Scores, score_views
from nerfreg.evaluation.trained import evaluated
from nerfreg.field.fit import fitted
from nerfreg.registry import Hooks, Term
from nerfreg.runs.files import METRICS, append_metrics, write_results
from nerfreg.runs.load import load_trained, prepare
from nerfreg.runs.pictures import saving, strided
from nerfreg.runs.recording import StepRecorder
from nerfreg.runs.results import description, evaluation_record, losses, summary
from nerfreg.scenes import load_scene
from nerfreg.scenes.layouts import said
from nerfreg.training.checked_hooks import CheckedHooks
from nerfreg.training.checkpoint import State, save_checkpoint
from nerfreg.training.guard import Guard
from nerfreg.training.memory import keep_large_blocks
from nerfreg.training.progress import Progress
from nerfreg.training.trainer import Trainer


def train(config: Config, folder: Path) -> dict[str, Any]:
    """Train, score at times evenly spaced on a logarithmic scale, and leave a run in `folder`.

    During the run a fixed subset of the test views is scored, on some of their pixels; at the end
    all of them, at full size. Neither affects the training.

    Args:
        config: Configuration of the run.
        folder: Its folder; what an earlier run has left there is replaced.

    Returns:
        What `results.json` holds.

    Raises:
        NonFiniteError: Too many steps in a row had a loss or gradient that is not finite; the
            checkpoint of the last good weights is saved.
        NerfregError: The configuration does not fit the scene or this machine.
    """
    # Must come before large tensors are allocated.
    keep_large_blocks()
    scene = load_scene(config.scene)
    config = replace(config, field=fitted(config.field, scene))
    lpips = load_lpips(config.eval.lpips_weights) if config.eval.lpips else None
    progress = Progress(config.train.quiet)
    if scene.layout_found:
        progress.message(said(scene.name, scene.layout))
    device = prepare(config)
    hooks = (
        CheckedHooks(config.reg, config.train.check_every)
        if config.train.check
        else Hooks(config.reg)
    )
    if hooks.preparing:
        # This may take a while, before the first step and thus before the bar.
        names = ", ".join(hooks.preparing)
        progress.message(f"{names}: analysing {len(scene.train)} photographs")
    trainer = Trainer(
        scene,
        hooks,
        config.field,
        config.sampler,
        config.optim,
        config.train,
        config.seed,
        device,
        Guard(StepRecorder(folder, config), progress.warning),
    )
    # Metrics are appended to, and must not go on from those of an earlier run in this folder.
    (folder / METRICS).unlink(missing_ok=True)
    with progress:
        terms = _loop(trainer, config, folder, lpips, progress)
        trainer.end()
        # Saved before scoring, which takes minutes and can be repeated by `nerfreg evaluate`.
        _save(folder, trainer)
        with evaluated(trainer) as trained:
            _, saved = load_trained(folder, config, scene, hooks.fresh(), device)
            require_no_leak(trained, saved)
            progress.message(f"scoring {len(scene.test)} test views")
            render = saving(trained, config.eval.save_renders, folder)
            scores = score_views(scene, scene.test, render, lpips, measure=trained.measure)
    record = _append(folder, trainer, scores, terms)
    results = {**record, **description(config, scene)}
    write_results(folder, results)
    for line in summary(results):
        print(line)
    print(folder)
    return results


def _loop(
    trainer: Trainer, config: Config, folder: Path, lpips: LPIPS | None, progress: Progress
) -> list[Term]:
    """Spend the budget, and return the terms of the last step."""
    scene, budget = trainer.scene, trainer.budget
    due = list(config.eval.times(config.train.seconds, config.train.steps))
    subset = subset_of(scene.test, config.eval.subset_size)
    psnr: float | None = None
    terms: list[Term] = []
    while budget.fraction < 1:
        try:
            terms = trainer.step()
        except NonFiniteError:
            # The weights from before the fault are good and can still be evaluated.
            _save(folder, trainer)
            raise
        progress.update(budget.step, budget.fraction, losses(terms), psnr)
        # The evaluation at the end is that of all views and is made by the caller. A long step may
        # pass several times at once, which are then scored once.
        if due[0] <= budget.fraction < 1:
            due = [share for share in due if share > budget.fraction]
            with evaluated(trainer) as trained:
                # A new renderer each time, whose occupancy grid belongs to the present weights.
                render = strided(trained, config.eval.pixels_stride)
                scores = score_views(scene, subset, render, lpips, config.eval.pixels_stride)
            psnr = scores.psnr
            _append(folder, trainer, scores, terms)
    return terms


def _append(
    folder: Path, trainer: Trainer, scores: Scores, terms: Sequence[Term]
) -> dict[str, Any]:
    record = evaluation_record(_state(trainer), trainer.scene, scores, terms)
    append_metrics(folder, record)
    return record


def _save(folder: Path, trainer: Trainer) -> None:
    # The averaged weights, because these are the ones that are evaluated.
    state = replace(_state(trainer), plugins=trainer.hooks.state_dict())
    with trainer.average.applied():
        save_checkpoint(folder, trainer.field, state)


def _state(trainer: Trainer) -> State:
    budget = trainer.budget
    return State(
        budget.step,
        budget.seconds,
        trainer.renderer.points,
        trainer.guard.skipped,
        budget.fraction,
    )
