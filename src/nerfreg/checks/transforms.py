"""Checks of what comes before a field is evaluated: `nerfreg_needs`, `nerfreg_ray_bounds`, `nerfreg_encoder_input`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from nerfreg.checks.cases import SIZES
from nerfreg.checks.driver import Driver
from nerfreg.checks.exact import relative_error
from nerfreg.checks.inputs import Inputs
from nerfreg.checks.losses import broken_promises
from nerfreg.checks.masks import BACKENDS, GRID_WIDTH, wrong_masks
from nerfreg.checks.report import LIMITS, Report, Spot
from nerfreg.checks.subject import Subject
from nerfreg.field.directions import WIDTH
from nerfreg.training.contracts import Untouched, wrong_bounds, wrong_needs, wrong_samples

FRACTIONS = (0.0, 0.01, 0.05, 0.5, 1.0, 2.0)
"""Shares of the run at which a step is tried; 2 is beyond its end."""


def check_needs(report: Report, subject: Subject, inputs: Inputs, spot: Spot) -> None:
    """The plugin asks for what the core can render."""
    driver = Driver(inputs, subject.hooks(), subject.name)
    wrong = [
        line
        for at in FRACTIONS
        for line in _at(at, wrong_needs(driver.hooks.needs(driver.step(at))))
    ]
    report.judge("contract", spot, wrong)


def check_ray_bounds(report: Report, subject: Subject, inputs: Inputs, spot: Spot) -> None:
    """Near and far are finite and in order at every step, and the exact ones where the plugin ships them."""
    driver = Driver(inputs, subject.hooks(), subject.name)
    rays, wrong = inputs.rays, []
    for at in FRACTIONS:
        step, watch = driver.step(at), Untouched(rays)
        near, far = driver.hooks.ray_bounds(rays, step)
        driver.keep_contract(step)
        found = watch.edits() + wrong_bounds(near, far, rays)
        wrong += _at(at, found)
        if not found:
            truth = driver.hooks.reference(subject.name, rays, driver.step(at))
            _compare(report, spot, {"near": near, "far": far}, truth)
    report.judge("contract", spot, wrong + broken_promises(driver))


def check_encoder_input(report: Report, subject: Subject, inputs: Inputs, spot: Spot) -> None:
    """Samples keep their shapes and stay finite; features that are not alive have no influence on a real field."""
    driver = Driver(inputs, subject.hooks(), subject.name)
    wrong = []
    for at in FRACTIONS:
        before = replace(driver.samples(), density_width=GRID_WIDTH, color_width=WIDTH)
        step, watch = driver.step(at), Untouched(before)
        after = driver.hooks.encoder_input(before, step)
        driver.keep_contract(step)
        found = watch.edits() + wrong_samples(before, after)
        if not found:
            truth = driver.hooks.reference(subject.name, before, driver.step(at))
            _compare(report, spot, {name: getattr(after, name) for name in truth}, truth)
        if not found and spot.dtype == "float32" and spot.samples == SIZES[-1]:
            found = [line for backend in BACKENDS for line in wrong_masks(after, backend)]
        wrong += _at(at, found)
    report.judge("contract", spot, wrong + broken_promises(driver))


def _compare(
    report: Report, spot: Spot, values: Mapping[str, Any], truth: Mapping[str, Any]
) -> None:
    if spot.dtype in LIMITS:
        for name in values.keys() & truth.keys():
            error = relative_error(values[name], truth[name], spot.dtype)
            report.measure(name, spot, error, LIMITS[spot.dtype])


def _at(fraction: float, wrong: list[str]) -> list[str]:
    return [f"at {fraction:g} of the run: {line}" for line in wrong]
