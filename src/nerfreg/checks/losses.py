"""Checks of `nerfreg_loss`."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from nerfreg.checks.cases import SIZES, Case
from nerfreg.checks.driver import Driver
from nerfreg.checks.exact import relative_error
from nerfreg.checks.gradients import wrong_gradient
from nerfreg.checks.inputs import Inputs
from nerfreg.checks.report import LIMITS, Report, Spot
from nerfreg.checks.subject import Subject
from nerfreg.hooks import Rays, Rendering
from nerfreg.numerics import not_finite
from nerfreg.registry import Term
from nerfreg.training.contracts import Untouched, wrong_terms

OWN_LIMIT, OWN_FLOOR = 1e-3, 1e-12
"""A plugin without exact values may be this far off its own value in float64, where that is above the floor."""

PROMISE = 1e-6
"""By how much a plugin may break what it promises of itself: rounding, which is more in half precision."""

SCALE = 2.0**10
"""A power of two, so that scaling rounds nothing."""

SAMPLES = SIZES[-1]


@dataclass(frozen=True)
class Outcome:
    """What a plugin made of one batch. random: whether it drew random numbers."""

    driver: Driver
    terms: list[Term]
    edits: list[str]
    random: bool


def check_losses(report: Report, subject: Subject, case: Case, inputs: Inputs, spot: Spot) -> None:
    """All that can be said of the loss of one batch, in the precision that the inputs have."""
    outcome = evaluate(subject, inputs)
    wrong = outcome.edits + wrong_terms({t.name: t.value for t in outcome.terms})
    report.judge("value", spot, wrong)
    if outcome.driver.broken:
        report.judge("contract", spot, broken_promises(outcome.driver))
    if wrong:
        return
    report.judge("gradient", spot, _wrong_gradients(outcome))
    if spot.dtype not in LIMITS:
        return
    _compare(report, subject, outcome, spot)
    if spot.samples == SAMPLES and not outcome.random:
        report.judge("invariance", spot, _variances(subject, outcome, spot))
    if case.regular and spot.dtype == "float64" and spot.samples in SIZES:
        report.judge("gradient", spot, _against_differences(subject, inputs, outcome))


def evaluate(subject: Subject, inputs: Inputs) -> Outcome:
    """Render the rays, and call the plugin's loss."""
    driver = Driver(inputs, subject.hooks(), subject.name)
    step = driver.step()
    before = step.generator.get_state()
    watch = Untouched(driver.rendering)
    terms = driver.hooks.losses(driver.rendering, step)
    driver.keep_contract(step)
    return Outcome(
        driver, terms, watch.edits(), not torch.equal(before, step.generator.get_state())
    )


def broken_promises(driver: Driver) -> list[str]:
    """What the plugin's contract said, as far as it is more than rounding."""
    rounding = max(PROMISE, torch.finfo(driver.inputs.density.dtype).eps)
    return [
        f"promise broken: {name}, by {excess:.2g}"
        for name, excess in driver.broken.items()
        if not excess <= rounding
    ]


def _wrong_gradients(outcome: Outcome) -> list[str]:
    leaves = outcome.driver.leaves
    names = ["density", "rgb", *["a parameter of the networks"] * (len(leaves) - 2)]
    wrong = []
    for term in outcome.terms:
        if term.value.requires_grad:
            grads = torch.autograd.grad(term.value, leaves, retain_graph=True, allow_unused=True)
            found = [
                not_finite(name, grad)
                for name, grad in zip(names, grads, strict=True)
                if grad is not None
            ]
            wrong += [f"gradient of '{term.name}' by {line}" for lines in found for line in lines]
    return wrong


def _compare(report: Report, subject: Subject, outcome: Outcome, spot: Spot) -> None:
    driver = outcome.driver
    truth = driver.hooks.reference(subject.name, driver.rendering, driver.step())
    for term in outcome.terms:
        if term.name in truth:
            error = relative_error(term.value, truth[term.name], spot.dtype)
            report.measure(f"term '{term.name}'", spot, error, LIMITS[spot.dtype])
    unknown = [term.name for term in outcome.terms if term.name not in truth]
    if unknown and spot.dtype == "float32":
        own = _own_values(subject, outcome)
        for term in outcome.terms:
            if term.name in unknown and abs(own.get(term.name, 0.0)) > OWN_FLOOR:
                error = relative_error(term.value, own[term.name], spot.dtype)
                report.inform(f"term '{term.name}'", spot, error, OWN_LIMIT)


def _own_values(subject: Subject, outcome: Outcome) -> dict[str, float]:
    """The terms of the same rendering, cast to float64."""
    driver = Driver(outcome.driver.inputs.to(torch.float64), subject.hooks(), subject.name)
    terms = driver.hooks.losses(_as_double(outcome.driver.rendering), driver.step())
    return {term.name: float(term.value.detach()) for term in terms}


def _as_double(rendering: Rendering) -> Rendering:
    def cast(part: Rendering | Rays) -> dict[str, Tensor]:
        values = {field.name: getattr(part, field.name) for field in fields(part)}
        return {
            name: value.detach().double()
            for name, value in values.items()
            if isinstance(value, Tensor) and value.is_floating_point()
        }

    return replace(
        rendering, rays=replace(rendering.rays, **cast(rendering.rays)), **cast(rendering)
    )


def _variances(subject: Subject, outcome: Outcome, spot: Spot) -> list[str]:
    """Changes of the batch that must not change the loss, and do."""
    inputs = outcome.driver.inputs
    changes = {
        "the order of the rays": inputs.permuted(torch.Generator().manual_seed(2)),
        "twice the same rays": inputs.repeated(2),
    }
    if subject.plugin().scale_free:
        changes["a scene 1024 times as large"] = inputs.scaled(SCALE)
    wrong = []
    for change, changed in changes.items():
        after = {term.name: term.value for term in evaluate(subject, changed).terms}
        for term in outcome.terms:
            error = relative_error(after[term.name], term.value.item(), spot.dtype)
            if not error <= LIMITS[spot.dtype]:
                values = f"{term.value.item():.7g} became {after[term.name].item():.7g}"
                wrong.append(f"term '{term.name}' depends on {change}: {values}")
    return wrong


def _against_differences(subject: Subject, inputs: Inputs, outcome: Outcome) -> list[str]:
    wrong = []
    for index, term in enumerate(outcome.terms):
        if not term.value.requires_grad:
            continue

        def loss(moved: Inputs, index: int = index) -> tuple[Tensor, list[Tensor]]:
            driver = Driver(moved, subject.hooks(), subject.name)
            value = driver.hooks.losses(driver.rendering, driver.step())[index].value
            return value, [driver.density, driver.colors]

        wrong += [f"term '{term.name}': {line}" for line in wrong_gradient(loss, inputs)]
    return wrong
