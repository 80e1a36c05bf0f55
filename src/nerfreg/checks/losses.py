"""Checks of `nerfreg_loss`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import torch
from torch import Tensor

from nerfreg.checks.accuracy import not_finite_gradients, relative_error, wrong_gradient
from nerfreg.checks.cases import SIZES, Case
from nerfreg.checks.driver import Driver
from nerfreg.checks.inputs import Inputs, cast
from nerfreg.checks.report import LIMITS, Report
from nerfreg.checks.subject import Subject
from nerfreg.rays.batch import Batch
from nerfreg.training.contracts import Untouched, wrong_terms

OWN_FLOOR = 1e-12
"""Below this a value is not compared with the plugin's own in float64."""

SCALE = 2.0**10
"""A power of two, so that scaling rounds nothing."""


def check_losses(report: Report, case: Case, inputs: Inputs) -> None:
    """Check all that can be said of the loss of one batch, in the precision of the inputs."""
    driver, spot = Driver(report.subject, inputs), report.spot
    batch, watch = Batch.of(inputs.rays, driver.step()), Untouched(driver.rendering)
    terms = driver.terms(batch.step)
    driver.keep_contract(batch.step)
    # Losses of half precision are computed in float32.
    dtype = torch.float32 if spot.dtype == "float32" else None
    wrong = watch.edits() + wrong_terms(terms, dtype)
    report.judge("value", wrong)
    if driver.broken:
        report.judge("contract", driver.broken_promises())
    if wrong:
        return
    trained = {name: value for name, value in terms.items() if value.requires_grad}
    wrong = [
        line
        for name, value in trained.items()
        for line in not_finite_gradients(f"gradient of '{name}' by ", value, driver.leaves)
    ]
    report.judge("gradient", wrong)
    if spot.dtype in LIMITS:
        _compare(report, driver, terms)
        # A loss that draws random numbers draws others for another batch.
        if spot.samples == SIZES[-1] and not batch.drawn:
            report.judge("invariance", _variances(driver, terms, spot.dtype))
    if case.differentiable(spot):
        for name in trained:
            lines = wrong_gradient(partial(_term, driver.subject, name), inputs)
            report.judge("gradient", [f"term '{name}': {line}" for line in lines])


def _term(subject: Subject, name: str, inputs: Inputs) -> tuple[Tensor, list[Tensor]]:
    driver = Driver(subject, inputs)
    return driver.terms(driver.step())[name], [driver.density, driver.colors]


def _compare(report: Report, driver: Driver, terms: Mapping[str, Tensor]) -> None:
    """With exact values, or with the plugin's own of the same rendering cast to float64."""
    truth = driver.reference(driver.rendering)
    report.compare(terms, truth, "term '{}'")
    unknown = [name for name in terms if name not in truth]
    if unknown and report.spot.dtype == "float32":
        double = Driver(driver.subject, cast(driver.inputs, torch.float64))
        own = double.terms(double.step(), cast(driver.rendering, torch.float64))
        for name in unknown:
            if name in own and abs(own[name].item()) > OWN_FLOOR:
                report.compare_own(f"term '{name}'", terms[name], own[name])


def _variances(driver: Driver, terms: Mapping[str, Tensor], dtype: str) -> list[str]:
    """Changes of the batch that must not change the loss, and do."""
    inputs, subject = driver.inputs, driver.subject
    changes = {
        "the order of the rays": inputs.permuted(torch.Generator().manual_seed(2)),
        "twice the same rays": inputs.repeated(2),
    }
    if driver.hooks.plugins[subject.name].scale_free:
        changes["a scene 1024 times as large"] = inputs.scaled(SCALE)
    wrong = []
    for change, changed in changes.items():
        again = Driver(subject, changed)
        after = again.terms(again.step())
        for name, value in terms.items():
            if not relative_error(after[name], value, dtype) <= LIMITS[dtype]:
                values = f"{value.item():.7g} became {after[name].item():.7g}"
                wrong.append(f"term '{name}' depends on {change}: {values}")
    return wrong
