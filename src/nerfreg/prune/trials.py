"""A real trial: train in this process and score the views held out, reading no test image."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import cache
from itertools import pairwise
from statistics import fmean, median

from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError, NonFiniteError
from nerfreg.evaluation.lpips import load_lpips
from nerfreg.evaluation.scores import Scores, score_views
from nerfreg.hooks import Regularizer
from nerfreg.prune.ledger import Measurement
from nerfreg.prune.plan import Trial
from nerfreg.registry import Hooks
from nerfreg.rendering.views import ViewRenderer
from nerfreg.runs.load import prepare
from nerfreg.scenes import Scene, load_scene
from nerfreg.training.guard import Guard
from nerfreg.training.memory import keep_large_blocks
from nerfreg.training.trainer import Trainer

TENTHS = 10


class Trials:
    """Measures trials of a configuration.

    Attributes:
        scene: With the first training view held out.
    """

    def __init__(self, config: Config, stride: int, report: Callable[[str], None]) -> None:
        """Load what all trials share.

        Args:
            config: Already holds some training view out, so that no test view is ever looked for.
            stride: Every how many rows and columns are scored. `average` is known at 1 only, and
                needs `eval.lpips`.
            report: Takes a line about every step that was left out.

        Raises:
            NerfregError: The scene cannot be used, or has a single training view.
        """
        keep_large_blocks()
        self.scene = _held_out_scene(config)
        self._config = config
        self._stride = stride
        self._report = report
        self._device = prepare(config)
        scores_lpips = stride == 1 and config.eval.lpips
        self._lpips = load_lpips(config.eval.lpips_weights) if scores_lpips else None
        self._read_image = cache(self.scene.read_image)

    def __call__(self, trial: Trial) -> Measurement:
        """Train and score; there is no score if too many steps in a row were not finite."""
        begun = time.perf_counter()
        config = self._config
        held_out = replace(
            config.scene, held_out=list(trial.held_out), layout=self.scene.layout
        )  # All cells share one layout, and with it the defaults that depend on it.
        scene = replace(load_scene(held_out), read_image=self._read_image, read_depth=None)
        # Copies, because a plugin may remember something of a training that it took part in.
        plugins = {
            name: in_share(deepcopy(config.reg[name]), trial.steps, config.train.steps)
            for name in trial.regularizers
        }
        trainer = Trainer(
            scene,
            Hooks(plugins),
            config.field,
            config.sampler,
            config.optim,
            replace(config.train, steps=trial.steps, seconds=None),
            trial.seed,
            self._device,
            Guard(None, self._report),
        )
        scores: Scores | None = None
        failure: str | None = None
        before = trainer.budget.seconds
        clock = [before]
        try:
            while trainer.budget.fraction < 1:
                trainer.step()
                clock.append(trainer.budget.seconds)
            scores = self._score(trainer, scene)
        except NonFiniteError as error:
            failure = str(error)
        del trainer
        gc.collect()  # A trainer and its steps refer to each other; the next needs the memory.
        return Measurement(
            psnr=_finite(scores.psnr if scores else None),
            average=_finite(scores.average if scores else None),
            step_seconds=usual_time(clock) + before / (config.train.steps or trial.steps),
            seconds=time.perf_counter() - begun,
            failure=failure,
        )

    def _score(self, trainer: Trainer, scene: Scene) -> Scores:
        with trainer.average.applied():
            renderer = ViewRenderer(trainer.field, self._config.sampler, scene)
            return score_views(
                scene,
                scene.test,
                lambda view: renderer.view(scene.cameras, view, self._stride),
                self._lpips,
                self._stride,
            )


def _held_out_scene(config: Config) -> Scene:
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
    """Return the seconds of a step, the mean over the tenths of a training of the median in each.

    A median, because other programs interrupt; tenths, because what a step costs depends on the
    share of the budget that is spent.

    Args:
        clock: Seconds before the first step and after each; 0 is returned if there was no step.
    """
    seconds = [after - before for before, after in pairwise(clock)]
    parts = min(TENTHS, len(seconds))
    borders = [len(seconds) * part // parts for part in range(parts + 1)] if parts else [0]
    return fmean(median(seconds[a:b]) for a, b in pairwise(borders)) if parts else 0.0


def in_share(plugin: Regularizer, steps: int, whole: int | None) -> Regularizer:
    """Move a window in steps of a whole run to the same shares of a training of `steps`."""

    def moved(value: int | float) -> int | float:
        return value if isinstance(value, float) or whole is None else round(value * steps / whole)

    start, end = moved(plugin.start), moved(plugin.end)
    if isinstance(start, int) and isinstance(end, int):
        end = max(end, start + 1)
    if (start, end) == (plugin.start, plugin.end):
        return plugin
    return replace(plugin, start=start, end=end)


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
