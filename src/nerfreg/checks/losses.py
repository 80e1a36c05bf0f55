"""Checks of `nerfreg_loss`."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from nerfreg.checks.accuracy import not_finite_gradients, relative_error, wrong_gradient
from nerfreg.checks.cases import SIZES, Case
from nerfreg.checks.driver import Driver, Subject
from nerfreg.checks.inputs import Inputs, cast
from nerfreg.checks.report import LIMITS, Report
from nerfreg.training.contracts import Untouched, wrong_terms

OWN_FLOOR = 1e-12
"""Below this a value is not compared with the plugin's own in float64."""

SCALE = 2.0**10
"""A power of two, so that scaling rounds nothing."""


class Loss(NamedTuple):
    """The terms of a plugin's loss by name, what it edited, and whether it drew random numbers."""

    driver: Driver
    terms: dict[str, Tensor]
    edits: list[str]
    random: bool


def evaluate(subject: Subject, inputs: Inputs) -> Loss:
    """Render rays, and call the plugin's loss."""
    driver = Driver(subject, inputs)
    step, watch = driver.step(), Untouched(driver.rendering)
    before, terms = step.generator.get_state(), driver.terms(step)
    driver.keep_contract(step)
    random = not torch.equal(before, step.generator.get_state())
    return Loss(driver, terms, watch.edits(), random)


def check_losses(report: Report, subject: Subject, case: Case, inputs: Inputs) -> None:
    """Check all that can be said of the loss of one batch, in the precision of the inputs."""
    loss = evaluate(subject, inputs)
    wrong = loss.edits + wrong_terms(loss.terms)
    report.judge("value", wrong)
    if loss.driver.broken:
        report.judge("contract", loss.driver.broken_promises())
    if wrong:
        return
    trained = {name: value for name, value in loss.terms.items() if value.requires_grad}
    wrong = [
        line
        for name, value in trained.items()
        for line in not_finite_gradients(f"gradient of '{name}' by ", value, loss.driver.leaves)
    ]
    report.judge("gradient", wrong)
    if report.spot.dtype in LIMITS:
        _compare(report, subject, loss)
        if report.spot.samples == SIZES[-1] and not loss.random:
            report.judge("invariance", _variances(subject, loss, report.spot.dtype))
    if case.differentiable(report.spot):
        for name in trained:
            lines = wrong_gradient(partial(_term, subject, name), inputs)
            report.judge("gradient", [f"term '{name}': {line}" for line in lines])


def _term(subject: Subject, name: str, inputs: Inputs) -> tuple[Tensor, list[Tensor]]:
    driver = Driver(subject, inputs)
    return driver.terms(driver.step())[name], [driver.density, driver.colors]


def _compare(report: Report, subject: Subject, loss: Loss) -> None:
    """With exact values, or with the plugin's own of the same rendering cast to float64."""
    truth = loss.driver.reference(loss.driver.rendering)
    for name in loss.terms:
        if name in truth:
            report.compare(f"term '{name}'", loss.terms[name], truth[name])
    unknown = [name for name in loss.terms if name not in truth]
    if unknown and report.spot.dtype == "float32":
        driver = Driver(subject, cast(loss.driver.inputs, torch.float64))
        rendering = cast(loss.driver.rendering, torch.float64)
        own = driver.terms(driver.step(), rendering)
        for name in unknown:
            if name in own and abs(own[name].item()) > OWN_FLOOR:
                report.compare_own(f"term '{name}'", loss.terms[name], own[name])


def _variances(subject: Subject, loss: Loss, dtype: str) -> list[str]:
    """Changes of the batch that must not change the loss, and do."""
    inputs = loss.driver.inputs
    changes = {
        "the order of the rays": inputs.permuted(torch.Generator().manual_seed(2)),
        "twice the same rays": inputs.repeated(2),
    }
    if loss.driver.hooks.plugins[subject.name].scale_free:
        changes["a scene 1024 times as large"] = inputs.scaled(SCALE)
    wrong = []
    for change, changed in changes.items():
        after = evaluate(subject, changed).terms
        for name, value in loss.terms.items():
            if not relative_error(after[name], value, dtype) <= LIMITS[dtype]:
                values = f"{value.item():.7g} became {after[name].item():.7g}"
                wrong.append(f"term '{name}' depends on {change}: {values}")
    return wrong
