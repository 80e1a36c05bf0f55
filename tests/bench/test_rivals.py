"""The other forms are what they claim to be: right where nothing is lost, wrong where they lose."""

from __future__ import annotations

import pytest
import torch

from nerfreg.bench.inputs import INPUTS, LossInput
from nerfreg.bench.losses import PLUGIN, forward_and_backward, measure
from nerfreg.bench.rivals import RIVALS
from nerfreg.bench.timing import RaySizes
from nerfreg.hooks import Step
from nerfreg.registry import Hooks, installed

CASES = [
    pytest.param(name, loss, id=f"{name}: {form}")
    for name, forms in RIVALS.items()
    for form, loss in forms.items()
]


def given(name: str) -> LossInput:
    return next(given for given in INPUTS if given.name == name)


def own_loss(name: str):
    (info,) = [info for info in installed() if info.name == name]
    hooks = Hooks({name: info.cls(weight=1.0, start=0.0)})
    step = Step(50, 100, 0.5, torch.Generator(), (2.0, 6.0))
    return lambda rendering: hooks.losses(rendering, step)[0].value


@pytest.mark.parametrize(("name", "loss"), CASES)
def test_agrees_with_the_plugin_forward_and_backward(name: str, loss) -> None:
    rendering = given("benign").rendering(32, 24, torch.float64)
    value, gradients = forward_and_backward(own_loss(name), rendering)
    other, others = forward_and_backward(loss, rendering)
    # 1e-10 is added to numbers of the order 1 / N, at most.
    torch.testing.assert_close(other, value, rtol=1e-7, atol=0.0)
    total = sum(gradient.sum() for gradient in _common(gradients, others)[0])
    torch.testing.assert_close(
        sum(gradient.sum() for gradient in _common(gradients, others)[1]), total
    )


def _common(gradients, others):
    """Gradients of both with respect to what both are functions of."""
    names = [name for name in gradients if gradients[name] is not None and others[name] is not None]
    return [gradients[name] for name in names], [others[name] for name in names]


@pytest.mark.parametrize(
    ("plugin", "form", "on", "lost"),
    [
        # Midpoints near 10000 are rounded to 5e-4, gaps between 32 of them are 3e-2.
        ("distortion", "all pairs", "packed", 1e-5),
        ("distortion", "prefix sums", "packed", 1e-5),
        # exp(-50) from a sum that is rounded to 6e-8.
        ("full_geometry", "1 - sum w", "peaked", 0.99),
        # alpha = 1e-6 is rounded to 6e-8; log(q + 1e-10) of q = 1 - 3e-5 is as good as it gets.
        ("entropy", "1 - exp(-tau)", "peaked", 1e-3),
        # log((1 + 1e-10) / (1e-9 + 1e-10)) instead of log(1 / 1e-9).
        ("kl", "+ 1e-10", "underflow", 1e-4),
    ],
)
def test_loses_digits_that_the_plugin_keeps(plugin: str, form: str, on: str, lost: float) -> None:
    (info,) = [info for info in installed() if info.name == plugin]
    points = measure(info, RaySizes((32,), rays=16, repetitions=1))

    def error(form: str) -> float:
        (point,) = [point for point in points if (point.form, point.input) == (form, on)]
        return point.relative_error

    assert error(form) > lost
    assert error(PLUGIN) < 1e-5


def test_prefix_sums_against_pairs_by_hand() -> None:
    # Edges 0 1 3, midpoints 1/2 and 2, weights 1/2 and 1/4, depth 2:
    # (2 * 1/2 * 1/4 * 3/2 + (1/4 * 1 + 1/16 * 2) / 3) / 2.
    rendering = given("benign").rendering(16, 2)
    rendering.t_edges = torch.tensor([[0.0, 1.0, 3.0]]).expand(16, 3)
    rendering.weights = torch.tensor([[0.5, 0.25]]).expand(16, 2)
    rendering.depth = torch.full((16,), 2.0)
    for loss in RIVALS["distortion"].values():
        assert loss(rendering).item() == pytest.approx(0.25)
