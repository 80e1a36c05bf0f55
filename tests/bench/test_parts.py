from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from types import SimpleNamespace

import pytest
import torch

from nerfreg.bench import parts
from nerfreg.bench.configured import step_at
from nerfreg.bench.parts import (
    BACKWARD,
    REST,
    Stopwatch,
    measure_parts,
    middle_mean,
    timed_parts,
)
from nerfreg.rendering import renderer
from nerfreg.training import loss
from nerfreg.training.trainer import Trainer

WITH_GRADIENT = ("compositing", "networks", "hash grid", "color loss")


@pytest.fixture
def wait(monkeypatch: pytest.MonkeyPatch):
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(parts, "perf_counter", lambda: clock.now)

    def wait(seconds: float) -> None:
        clock.now += seconds

    return wait


def test_an_inner_part_stops_the_outer_one(wait) -> None:
    watch = Stopwatch()
    wait(7)  # before anything is entered: nobody's
    with watch.part("outer"):
        wait(1)
        with watch.part("inner"):
            wait(2)
            with watch.part("outer"):
                wait(4)
        wait(8)
    wait(16)
    assert watch.take() == {"outer": 1 + 4 + 8, "inner": 2}
    assert watch.take() == {}


def test_an_error_leaves_the_part(wait) -> None:
    watch = Stopwatch()
    with watch.part("outer"):
        with pytest.raises(ValueError), watch.part("inner"):
            wait(1)
            raise ValueError
        wait(2)
    assert watch.take() == {"outer": 2, "inner": 1}


def test_every_part_of_a_step_is_met_forward_and_backward(make: Callable[..., Trainer]) -> None:
    measured = measure_parts(make("+reg=[distortion,annealing]"), at=0.5, steps=4)
    without = {"hooks", "rays", "sampling", "optimizer", "moving average", "annealing loss", REST}
    gradients = {*WITH_GRADIENT, "distortion loss"}
    assert set(measured) == without | gradients | {f"{name}{BACKWARD}" for name in gradients}
    # Each of them does something in every step, but for annealing, which has no loss.
    assert all(milliseconds > 0 for milliseconds in measured.values())


def test_the_parts_add_up_to_the_step(make: Callable[..., Trainer]) -> None:
    trainer = make("+reg=lipschitz")
    prepared = trainer.budget.seconds
    with timed_parts(trainer) as watch:
        begun = perf_counter()
        with watch.part(REST):
            step_at(trainer, 0.5)
        elapsed = perf_counter() - begun
    total = sum(watch.take().values())
    # Nothing is counted twice, and nothing is left out but entering and leaving the whole.
    assert trainer.budget.seconds - prepared <= total <= elapsed


def test_a_step_in_parts_trains_as_any_other(make: Callable[..., Trainer]) -> None:
    # PGD runs backward inside the loss, through nodes that are timed.
    choice = "+reg=[adversarial,lipschitz,kl]"
    plain, timed = make(choice), make(choice)
    for _ in range(2):
        step_at(plain, 0.5)
    with timed_parts(timed) as watch:
        for _ in range(2):
            step_at(timed, 0.5)
            watch.take()
    for one, other in zip(plain.field.parameters(), timed.field.parameters(), strict=True):
        assert torch.equal(one, other)


def test_everything_is_put_back(make: Callable[..., Trainer]) -> None:
    trainer, before = make(), renderer.importance
    with timed_parts(trainer):
        assert renderer.importance is not before
        assert "losses" in vars(trainer.hooks)
    assert renderer.importance is before
    for owner in (
        trainer,
        trainer.hooks,
        trainer.field.grid,
        trainer.renderer,
        trainer.optimizer,
        trainer.average,
    ):
        assert not {"step", "losses", "needs", "forward", "render", "update"} & set(vars(owner)), (
            owner
        )


def test_backward_time_belongs_to_the_part_that_went_forward(
    make: Callable[..., Trainer], monkeypatch
) -> None:
    # A colour loss whose gradient takes long: nothing else may be charged with it.
    clock = [0.0]
    monkeypatch.setattr(parts, "perf_counter", lambda: clock[0])

    class Slow(torch.autograd.Function):
        @staticmethod
        def forward(ctx, x):
            clock[0] += 1
            return x.clone()

        @staticmethod
        def backward(ctx, grad):
            clock[0] += 10
            return grad

    monkeypatch.setattr(
        loss, "color_error", lambda rendering: Slow.apply(rendering.rgb).square().mean()
    )
    assert {part: ms for part, ms in measure_parts(make(), 0.5, 1).items() if ms} == {
        "color loss": 1e3,
        f"color loss{BACKWARD}": 1e4,
    }


def test_the_middle_half_counts() -> None:
    # Sums 3, 8, 20, 100: the fastest and the slowest quarter, one step each, are left out.
    taken = [{"a": 100.0}, {"a": 1.0, "b": 2.0}, {"a": 20.0}, {"a": 4.0, "b": 4.0}]
    assert middle_mean(taken) == {"a": 12.0, "b": 2.0}
    assert middle_mean([{"a": 2.0}]) == {"a": 2.0}
