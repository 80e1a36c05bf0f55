"""Extreme learning rates and scales of the scene: all weights stay finite."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest
from torch import Tensor

from nerfreg.scenes import Scene
from nerfreg.training.guard import Guard
from nerfreg.training.trainer import Trainer

EXTREMES = pytest.mark.parametrize("lr, scale", [(0.1, 1.0), (1.0, 1.0), (0.01, 1e-3), (0.01, 1e3)])


def state(trainer: Trainer) -> list[Tensor]:
    """Weights, averages, and what Adam remembers."""
    adam = [value for moments in trainer.optimizer.state.values() for value in moments.values()]
    return [*trainer.field.parameters(), *trainer.average.averages, *adam]


def train(
    make: Callable[..., Trainer], change: Callable[[Scene], Scene], lr: float, steps: int
) -> Trainer:
    lines: list[str] = []
    words = (
        "+reg=combinerf",
        f"optim.lr={lr}",
        "scene.size=32",
        f"train.steps={steps}",
        "field.log2_entries=14",
    )
    trainer = make(*words, change=change, guard=Guard(None, lines.append))
    for _ in range(steps):
        trainer.step()
        assert all(bool(t.isfinite().all()) for t in state(trainer)), trainer.budget.step
    print(f"{trainer.guard.skipped} of {steps} steps left out", *lines, sep="\n")
    return trainer


@EXTREMES
def test_thirty_steps(
    lr: float, scale: float, make: Callable[..., Trainer], scaled: Callable[[Scene, float], Scene]
) -> None:
    assert train(make, partial(scaled, factor=scale), lr, 30).guard.skipped == 0


@pytest.mark.slow
@EXTREMES
def test_two_thousand_steps(
    lr: float, scale: float, make: Callable[..., Trainer], scaled: Callable[[Scene, float], Scene]
) -> None:
    assert train(make, partial(scaled, factor=scale), lr, 2000).guard.skipped == 0
