"""Budgets in steps and seconds."""

from __future__ import annotations

import time

import pytest
from numba import njit
from numba.core.event import install_timer

from nerfreg.errors import NerfregError
from nerfreg.training.budget import Budget
from nerfreg.training.config import TrainConfig


def test_steps() -> None:
    budget = Budget(TrainConfig(steps=4))
    fractions = []
    for _ in range(4):
        fractions.append(budget.fraction)
        assert budget.total == 4
        with budget.spend():
            pass
    assert fractions == [0.0, 0.25, 0.5, 0.75] and budget.fraction == 1.0


def test_seconds_count_only_what_is_spent() -> None:
    budget = Budget(TrainConfig(steps=None, seconds=100.0))
    with budget.spend():
        time.sleep(0.02)
    spent = budget.seconds
    time.sleep(0.02)
    assert budget.seconds == spent >= 0.02
    assert budget.fraction == pytest.approx(spent / 100)
    assert budget.total == round(100 / spent)


def test_preparation_takes_time_and_no_step() -> None:
    budget = Budget(TrainConfig(steps=4, seconds=100.0))
    with budget.prepare():
        time.sleep(0.02)
    assert budget.step == 0 and budget.seconds >= 0.02
    assert budget.fraction == pytest.approx(budget.seconds / 100)
    budget = Budget(TrainConfig(steps=None, seconds=100.0))
    with budget.prepare():
        time.sleep(0.05)
    prepared = budget.seconds
    with budget.spend():
        time.sleep(0.01)
    # What is left after the preparation goes to steps like this one.
    assert budget.total == round((100 - prepared) / (budget.seconds - prepared))


@pytest.mark.parametrize("part", ["spend", "prepare"])
def test_compilation_counts_nowhere(part: str) -> None:
    @njit
    def compiled_at_its_first_call(x: float) -> float:
        return x + 1

    compilation = []
    budget = Budget(TrainConfig(steps=4))
    start = time.perf_counter()
    with install_timer("numba:compile", compilation.append), getattr(budget, part)():
        time.sleep(0.02)
        assert compiled_at_its_first_call(1.0) == 2.0
    taken = time.perf_counter() - start
    assert 0.02 <= budget.seconds <= taken - compilation[0]


def test_whichever_comes_first() -> None:
    budget = Budget(TrainConfig(steps=10, seconds=20.0))
    budget.step, budget.seconds = 5, 15.0
    assert budget.fraction == 0.75
    assert budget.total == 7  # 5 steps in 15 s make 6.7 in 20 s
    budget.seconds = 1.0
    assert budget.fraction == 0.5 and budget.total == 10
    budget.seconds = 30.0
    assert budget.fraction == 1.0


@pytest.mark.parametrize(
    "config, message",
    [
        (TrainConfig(steps=None), r"train.steps and train.seconds are both null"),
        (TrainConfig(steps=0), r"train.steps=0: must be positive"),
        (TrainConfig(seconds=-1.0), r"train.seconds=-1.0: must be positive"),
        (TrainConfig(rays=0), r"train.rays=0: must be positive"),
    ],
)
def test_budgets_without_an_end_are_refused(config: TrainConfig, message: str) -> None:
    with pytest.raises(NerfregError, match=message):
        Budget(config)
