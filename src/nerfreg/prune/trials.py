"""One trial for real: train in this process, score the views that were held out, read no test image."""

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

from torch import Tensor

from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError, NonFiniteError
from nerfreg.evaluation.lpips import load_lpips
from nerfreg.evaluation.scores import Scores, score_views
from nerfreg.hooks import Regularizer
from nerfreg.prune.ledger import Measurement
from nerfreg.prune.plan import Selection, Trial
from nerfreg.registry import Hooks
from nerfreg.rendering.views import ViewRenderer
from nerfreg.runs.load import prepare
from nerfreg.scenes import Scene, load_scene
from nerfreg.training.guard import Guard
from nerfreg.training.memory import keep_large_blocks
from nerfreg.training.trainer import Trainer

TENTHS = 10


class Trials:
    """Measures trials of a configuration whose scene holds some training view out already.

    stride: of the rows and columns that are scored. `average` is known at stride 1 only, and needs eval.lpips.
    report: takes a line about every step that was left out.
    """

    def __init__(self, config: Config, stride: int, report: Callable[[str], None]) -> None:
        keep_large_blocks()
        self.scene = held_out_scene(config)
        self.config = config
        self._stride = stride
        self._report = report
        self._device = prepare(config)
        self._lpips = (
            load_lpips(config.eval.lpips_weights) if stride == 1 and config.eval.lpips else None
        )
        self._read_image = cache(self.scene.read_image)

    @property
    def views(self) -> int:
        """How many training views there are, the one that is held out included."""
        return len(self.scene.train) + len(self.scene.test)

    def __call__(self, trial: Trial) -> Measurement:
        """Train and score; a training that met too many steps without a finite loss has no score."""
        begun = time.perf_counter()
        config, scene = self.config, self._scene(trial)
        trainer = Trainer(
            scene,
            Hooks(self._regularizers(trial.regularizers, trial.steps)),
            config.field,
            config.sampler,
            config.optim,
            replace(config.train, steps=trial.steps, seconds=None),
            trial.cell.seed,
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
        gc.collect()  # a trainer and its steps refer to each other; the next one needs the memory
        return Measurement(
            psnr=_finite(scores.psnr if scores else None),
            average=_finite(scores.average if scores else None),
            step_seconds=usual_time(clock) + before / (config.train.steps or trial.steps),
            seconds=time.perf_counter() - begun,
            failure=failure,
        )

    def _score(self, trainer: Trainer, scene: Scene) -> Scores:
        with trainer.average.applied():
            renderer = ViewRenderer(trainer.field, self.config.sampler, scene)
            return score_views(
                scene,
                scene.test,
                lambda view: renderer.view(scene.cameras, view, self._stride),
                self._lpips,
                self._stride,
            )

    def _scene(self, trial: Trial) -> Scene:
        """The scene with this cell's views held out, of the layout that all cells share; images are read once."""
        held_out = list(trial.cell.held_out)
        scene = load_scene(replace(self.config.scene, held_out=held_out, layout=self.scene.layout))
        return replace(scene, read_image=self._image, read_depth=None)

    def _image(self, view: int) -> Tensor:
        return self._read_image(view)

    def _regularizers(self, names: Selection, steps: int) -> dict[str, Regularizer]:
        # Copies, because a plugin may remember something of the training that it took part in.
        return {
            name: in_share(deepcopy(self.config.reg[name]), steps, self.config.train.steps)
            for name in names
        }


def usual_time(clock: Sequence[float]) -> float:
    """Seconds of a step: the mean over the tenths of a training of the median in each.

    clock: seconds before the first step and after each. A median, because other programs interrupt; tenths, because
    what a step costs depends on the share of the budget. 0 where there was no step.
    """
    seconds = [after - before for before, after in pairwise(clock)]
    parts = min(TENTHS, len(seconds))
    borders = [len(seconds) * part // parts for part in range(parts + 1)] if parts else [0]
    return fmean(median(seconds[a:b]) for a, b in pairwise(borders)) if parts else 0.0


def held_out_scene(config: Config) -> Scene:
    """The scene of a configuration that holds its first training view out. Raises NerfregError where that is all."""
    try:
        return load_scene(config.scene)
    except NerfregError as error:
        if not str(error).startswith("scene.held_out"):
            raise
        raise NerfregError(
            "the scene has 1 training view; prune judges on training views that it holds out, and needs 2 (scene.views)"
        ) from error


def in_share(plugin: Regularizer, steps: int, whole: int | None) -> Regularizer:
    """The plugin with a window that is given in steps of a whole run moved to the same shares of a shorter one."""

    def moved(value: int | float) -> int | float:
        return value if isinstance(value, float) or whole is None else round(value * steps / whole)

    start, end = moved(plugin.start), moved(plugin.end)
    if isinstance(start, int) and isinstance(end, int):
        end = max(end, start + 1)
    return (
        plugin
        if (start, end) == (plugin.start, plugin.end)
        else replace(plugin, start=start, end=end)
    )


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
