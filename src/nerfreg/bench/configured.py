"""Trainers of any configuration, and their steps at any share of the budget."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

from rich.console import Console

from nerfreg.bench.timing import in_turns
from nerfreg.config.compose import compose, require_steps
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError
from nerfreg.registry import Hooks, Term
from nerfreg.runs.load import prepare
from nerfreg.scenes import load_scene
from nerfreg.scenes.scene import Scene
from nerfreg.training.memory import keep_large_blocks
from nerfreg.training.trainer import Trainer

T = TypeVar("T")
TINY = (
    *("train.rays=64", "sampler.coarse=8", "sampler.fine=8"),
    *("field.levels=4", "field.finest=32", "field.log2_entries=10"),
)
"""Overrides of a quick bench; those of the command line come after them and win."""


@dataclass(frozen=True, kw_only=True)
class TrainingSizes:
    """Timed steps, steps before them, and overrides that the command line may override."""

    steps: int
    warmup: int
    defaults: tuple[str, ...] = ()


@dataclass(frozen=True)
class TimedSteps:
    """Seconds of each step of one trainer, and evaluations of the density in a step."""

    seconds: list[float]
    points: float


def set_up(overrides: Sequence[str]) -> tuple[Config, Scene]:
    """Return a configuration and its scene, in a process that is ready to train with it.

    Raises:
        NerfregError: The overrides cannot be composed, leave the number of steps open or ask for
            another device than the CPU; or the scene cannot be loaded.
    """
    keep_large_blocks()
    config = compose(overrides)
    require_steps(config)
    if prepare(config).type != "cpu":
        raise NerfregError(
            f"device={config.device}: nerfreg bench measures the CPU; set device=cpu"
        )
    return config, load_scene(config.scene)


def make_trainer(config: Config, scene: Scene, hooks: Hooks | None = None) -> Trainer:
    """Return a trainer with a budget of steps alone; its hooks are the configuration's if None."""
    hooks, train = hooks or Hooks(config.reg), replace(config.train, seconds=None)
    return Trainer(scene, hooks, config.field, config.sampler, config.optim, train, config.seed)


def step_at(trainer: Trainer, share: float) -> list[Term]:
    """Take one training step where this share of the budget is spent."""
    assert trainer.budget.config.steps is not None
    trainer.budget.step = round(share * trainer.budget.config.steps)
    return trainer.step()


def time_steps(
    trainers: Sequence[Trainer], share: float, warmup: int, steps: int
) -> list[TimedSteps]:
    """Return the timed steps at a share of the budget; all trainers take turns, step by step."""
    calls = [partial(step_at, trainer, share) for trainer in trainers]
    in_turns(calls, warmup)
    before = [trainer.renderer.points for trainer in trainers]
    seconds = in_turns(calls, steps)
    return [
        TimedSteps(own, (trainer.renderer.points - points) / steps)
        for own, trainer, points in zip(seconds, trainers, before, strict=True)
    ]


def announced(items: Iterable[T], describe: Callable[[T], str]) -> Iterator[T]:
    """Yield items, and show on stderr which of them is being measured."""
    with Console(stderr=True).status("") as status:
        for item in items:
            status.update(describe(item))
            yield item
            # Trainers are in cycles of references and would stay in memory beside the next ones.
            gc.collect()
