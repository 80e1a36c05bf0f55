"""A real trial: train in this process and score the views held out, reading no test image."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise
from statistics import fmean, median

from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError, NonFiniteError
from nerfreg.evaluation.lpips import load_lpips
from nerfreg.evaluation.scores import Scores, score_views
from nerfreg.evaluation.trained import evaluated
from nerfreg.field.fit import fitted
from nerfreg.hooks import Regularizer
from nerfreg.prune.ledger import Measurement
from nerfreg.prune.plan import Trial
from nerfreg.registry import Hooks
from nerfreg.registry.plugins import with_changes
from nerfreg.runs.load import prepare
from nerfreg.scenes import Scene, load_scene
from nerfreg.training.memory import keep_large_blocks
from nerfreg.training.trainer import Trainer

TENTHS = 10


class Trials:
    """Measures trials of a configuration.

    Args:
        config: Holds some training view out already, so that no test view is even looked for.
        stride: Scores every so many rows and columns; at 1 also LPIPS, if `eval.lpips` is on.

    Attributes:
        scene: The scene of `config`.

    Raises:
        NerfregError: The scene cannot be used, or has a single training view.
    """

    def __init__(self, config: Config, stride: int) -> None:
        keep_large_blocks()
        self.scene = _scene(config)
        self._config = config
        self._stride = stride
        self._device = prepare(config)
        lpips = stride == 1 and config.eval.lpips
        self._lpips = load_lpips(config.eval.lpips_weights) if lpips else None
        self._read_image = cache(self.scene.read_image)

    def __call__(self, trial: Trial) -> Measurement:
        """Train and score; there is no score if too many steps in a row were not finite."""
        begun = time.perf_counter()
        trainer = self._trainer(trial)
        scores, failure = None, None
        clock = [before := trainer.budget.seconds]
        try:
            while trainer.budget.fraction < 1:
                trainer.step()
                clock.append(trainer.budget.seconds)
            scores = self._score(trainer)
        except NonFiniteError as error:
            failure = str(error)
        del trainer
        gc.collect()  # A trainer and its steps refer to each other; the next needs the memory.
        return Measurement(
            psnr=scores.psnr if scores and math.isfinite(scores.psnr) else None,
            average=scores.average if scores else None,
            step_seconds=usual_time(clock) + before / (self._config.train.steps or trial.steps),
            seconds=time.perf_counter() - begun,
            failure=failure,
        )

    def _trainer(self, trial: Trial) -> Trainer:
        config, held_out = self._config, list(trial.held_out)
        # Judged by its own training cameras, a cell might be of another kind than the next.
        cell = replace(config.scene, held_out=held_out, layout=self.scene.layout)
        scene = replace(load_scene(cell), read_image=self._read_image, read_depth=None)
        plugins = {
            name: in_share(config.reg[name], trial.steps, config.train.steps)
            for name in trial.regularizers
        }
        train = replace(config.train, steps=trial.steps, seconds=None)
        # The grid that a run on these views would have.
        parts = fitted(config.field, scene), config.sampler, config.optim
        return Trainer(scene, Hooks(plugins), *parts, train, trial.seed, self._device)

    def _score(self, trainer: Trainer) -> Scores:
        scene, stride = trainer.scene, self._stride
        with evaluated(trainer) as trained:
            render = partial(trained.renderer().view, scene.cameras, stride=stride)
            return score_views(scene, scene.test, render, self._lpips, stride)


def _scene(config: Config) -> Scene:
    try:
        return load_scene(config.scene)
    except NerfregError as error:
        if not str(error).startswith("scene.held_out"):
            raise
        raise NerfregError(
            "the scene has 1 training view; prune judges on training views that it holds out, "
            "and needs 2 (scene.views)"
        ) from error


def usual_time(clock: Sequence[float]) -> float:
    """Return the seconds of a step: the mean over the tenths of a training of the median in each.

    A median, because other programs interrupt; tenths, because what a step costs depends on the
    share of the budget that is spent.

    Args:
        clock: Seconds before the first step and after each; without a step the result is 0.
    """
    seconds = [after - before for before, after in pairwise(clock)]
    parts = min(TENTHS, len(seconds))
    borders = [len(seconds) * part // max(parts, 1) for part in range(parts + 1)]
    return fmean([median(seconds[a:b]) for a, b in pairwise(borders)] or [0.0])


def in_share(plugin: Regularizer, steps: int, whole: int | None) -> Regularizer:
    """Copy a plugin; a window in steps of a whole run moves to the same shares of `steps`.

    Always a copy, because a plugin may remember something of a training that it took part in.
    """

    def moved(value: int | float) -> int | float:
        return value if isinstance(value, float) or whole is None else round(value * steps / whole)

    start, end = moved(plugin.start), moved(plugin.end)
    if isinstance(start, int) and isinstance(end, int):
        end = max(end, start + 1)
    return with_changes(plugin, start=start, end=end)
