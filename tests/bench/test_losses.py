"""Any installed plugin with a loss and its exact value takes part."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch

from nerfreg import Regularizer, Rendering, Step, hookimpl
from nerfreg.bench import losses
from nerfreg.bench.losses import PLUGIN, SMALLEST, forward_and_backward, measure
from nerfreg.bench.timing import RaySizes
from nerfreg.errors import NerfregError
from nerfreg.registry import PluginInfo

SIZES = RaySizes((8,), rays=16, repetitions=1)


@dataclass
class Haze(Regularizer):
    """Mean opacity; its exact value is told a tenth too large."""

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering):
        return {"haze": rendering.opacity.mean()}

    @hookimpl
    def nerfreg_reference(self, given, step: Step):
        return (
            {"haze": 1.1 * given.opacity.double().mean().item()}
            if isinstance(given, Rendering)
            else None
        )


@dataclass
class Untold(Regularizer):
    """Ships no exact value."""

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering):
        return {"untold": rendering.opacity.mean()}


@dataclass
class Again(Haze):
    """Wants the rays rendered again."""

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step):
        return {"haze": step.rerender(rendering).opacity.mean()}


@dataclass
class Vanished(Regularizer):
    """A value that is 0 where it should be too small for float32."""

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering):
        return {"vanished": 0 * rendering.opacity.sum()}

    @hookimpl
    def nerfreg_reference(self, given, step: Step):
        return {"vanished": SMALLEST / 4}


def info(cls: type[Regularizer], name: str = "stranger") -> PluginInfo:
    return PluginInfo(name, "elsewhere", "1", cls)


def test_the_error_is_against_the_plugins_own_exact_value() -> None:
    points = measure(info(Haze), SIZES)
    assert [(point.input, point.form) for point in points] == [
        (name, PLUGIN) for name in ("benign", "packed", "peaked", "underflow")
    ]
    for point in points:
        # |v - 1.1 v| / 1.1 v
        assert point.relative_error == pytest.approx(0.1 / 1.1, rel=1e-5)
        assert point.exact == pytest.approx(1.1 * point.value, rel=1e-5)


def test_rivals_stand_beside_the_plugin_of_their_name() -> None:
    forms = {point.form for point in measure(info(Haze, "distortion"), SIZES)}
    assert forms == {PLUGIN, "all pairs", "prefix sums"}


def test_pairs_are_left_out_where_they_take_too_much_memory() -> None:
    points = measure(info(Haze, "distortion"), RaySizes((512, 513), rays=16, repetitions=1))
    assert {point.samples for point in points if point.form == "all pairs"} == {512}


def test_exact_values_below_the_smallest_number_count_as_that() -> None:
    assert {point.relative_error for point in measure(info(Vanished), SIZES)} == {0.25}


@pytest.mark.parametrize("cls", [Untold, Again])
def test_left_out(cls: type[Regularizer]) -> None:
    assert measure(info(cls), SIZES) == []


def test_a_broken_plugin_is_left_out() -> None:
    assert measure(PluginInfo("broken", "elsewhere", "1", None, "failed to import"), SIZES) == []


def test_nothing_to_measure(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(losses, "installed", lambda: [info(Untold)])
    with pytest.raises(NerfregError, match="no installed plugin ships exact values"):
        losses.run(tmp_path, SIZES)


def test_gradients_reach_what_the_loss_reads() -> None:
    rendering = losses.INPUTS[0].rendering(16, 8)
    value, gradients = forward_and_backward(
        lambda rendering: rendering.opacity.square().mean(), rendering
    )
    assert value == rendering.opacity.square().mean()
    torch.testing.assert_close(gradients["opacity"], rendering.opacity / 8)
    assert gradients["weights"] is None
    assert not rendering.opacity.requires_grad
