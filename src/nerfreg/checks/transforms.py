"""Checks of what happens before a field is evaluated: needs, ray bounds, input of the encoders."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import torch
from torch import Tensor
from torch.nn import functional

from nerfreg.checks.accuracy import not_finite_gradients
from nerfreg.checks.cases import SIZES, Case
from nerfreg.checks.driver import Driver
from nerfreg.checks.inputs import Inputs
from nerfreg.checks.report import Report
from nerfreg.checks.watch import WatchedHooks
from nerfreg.field import FieldConfig
from nerfreg.field.directions import WIDTH, spherical_harmonics
from nerfreg.field.grid_layout import FEATURES
from nerfreg.field.radiance_field import RadianceField
from nerfreg.hooks import Samples
from nerfreg.registry import Hooks
from nerfreg.training.contracts import Untouched, wrong_bounds, wrong_needs, wrong_samples

FRACTIONS = (0.0, 0.01, 0.05, 0.5, 1.0, 2.0)
"""Shares of the run at which a step is tried; 2 is beyond its end."""

RENDERING_HOOKS = ("rays", "empty", "density", "color_input", "rendering")
BACKENDS = ("torch", "numba")
POINTS, LEVELS = 256, 4
GRID_WIDTH = FEATURES * LEVELS


def check_needs(report: Report, _: Case, inputs: Inputs) -> None:
    """Check that the plugin asks for what the core can render."""
    if report.spots:  # which rays there are makes no difference: once is enough
        return
    driver = Driver(report.subject, inputs)
    found = {at: wrong_needs(driver.hooks.needs(driver.step(at))) for at in FRACTIONS}
    report.judge("contract", [line for at in found for line in _at(at, found[at])])


def check_ray_bounds(report: Report, _: Case, inputs: Inputs) -> None:
    """Check that near and far are finite, in order, and the exact ones where those are known."""
    driver = Driver(report.subject, inputs)
    rays, wrong = inputs.rays, []
    for at in FRACTIONS:
        step, watch = driver.step(at), Untouched(rays)
        near, far = driver.hooks.ray_bounds(rays, step)
        driver.keep_contract(step)
        found = watch.edits() + wrong_bounds(near, far, rays)
        wrong += _at(at, found)
        if not found:
            report.compare({"near": near, "far": far}, driver.reference(rays, at))
    report.judge("contract", wrong + driver.broken_promises())


def check_encoder_input(report: Report, _: Case, inputs: Inputs) -> None:
    """Check that samples stay finite, and that masked features have no influence on a field."""
    driver, spot, wrong = Driver(report.subject, inputs), report.spot, []
    for at in FRACTIONS:
        before = replace(driver.samples(), density_width=GRID_WIDTH, color_width=WIDTH)
        step, watch = driver.step(at), Untouched(before)
        after = driver.hooks.encoder_input(before, step)
        driver.keep_contract(step)
        found = watch.edits() + wrong_samples(before, after)
        if not found:
            truth = driver.reference(before, at)
            report.compare({name: getattr(after, name) for name in truth}, truth)
        if not found and spot.dtype == "float32" and spot.samples == SIZES[-1]:
            found = [line for backend in BACKENDS for line in wrong_masks(after, backend)]
        wrong += _at(at, found)
    report.judge("contract", wrong + driver.broken_promises())


def check_rendering(report: Report, case: Case, inputs: Inputs) -> None:
    """Check what the hooks between rays and rendering answer, and that gradients stay finite."""
    hooks = WatchedHooks(report.subject.selected())
    driver = Driver(report.subject, inputs, hooks)
    step = driver.step()
    rays = hooks.rays(inputs.rays, step)
    rendering = driver.render(rays, step, driver.rendering)
    report.judge("contract", hooks.take("contract") + driver.broken_promises())
    report.judge("effects", hooks.take("effects"))
    wrong = [
        line
        for name in ("rgb", "depth")
        for line in not_finite_gradients(
            f"gradient of rendering.{name} by ", getattr(rendering, name), driver.leaves
        )
    ]
    report.judge("gradient", wrong)


def _at(fraction: float, wrong: Iterable[str]) -> list[str]:
    return [f"at {fraction:g} of the run: {line}" for line in wrong]


def wrong_masks(samples: Samples, backend: str) -> list[str]:
    """Return what features that a plugin masks still do to the outputs and gradients of a field.

    Args:
        samples: As the plugin left them, for `GRID_WIDTH` features of a grid and `WIDTH` of
            directions. Where they lie makes no difference.
        backend: How the grid is computed, one of `BACKENDS`.
    """
    grid_alive, color_alive = samples.density_features, samples.color_features
    if grid_alive is None and color_alive is None:
        return []
    field = _small_field(backend)
    assert field.grid is not None
    table, layout = field.grid.table, field.grid.layout
    points = torch.rand(POINTS, 3, generator=torch.Generator().manual_seed(0))
    harmonics = spherical_harmonics(functional.normalize(points - 0.4, dim=1))
    level = torch.arange(LEVELS).repeat_interleave(torch.as_tensor(layout.offsets).diff())
    feature = FEATURES * level[:, None] + torch.arange(FEATURES)
    dead = feature >= (GRID_WIDTH if grid_alive is None else grid_alive)
    dead_harmonics = torch.arange(WIDTH) >= (WIDTH if color_alive is None else color_alive)

    def outputs(harmonics: Tensor) -> tuple[Tensor, Tensor]:
        raw = field.raw_density(points, grid_alive)
        return raw, field.color(raw, harmonics, color_alive)

    raw, color = outputs(harmonics)
    total = raw.sum() + color.sum()
    (grad,) = torch.autograd.grad(total, table, allow_unused=True, materialize_grads=True)
    kept = table.detach().clone()
    with torch.no_grad():
        table[dead] = 1.0
        raw_after, _ = outputs(harmonics)
        table.copy_(kept)
        _, color_after = outputs(torch.where(dead_harmonics, 100.0, harmonics))
    mistakes = {
        "dead grid features have a gradient": bool(grad[dead].any()),
        "dead grid features change the density": not torch.equal(raw_after, raw),
        "dead direction features change the colour": not torch.equal(color_after, color),
    }
    return [f"{backend} field: {mistake}" for mistake, made in mistakes.items() if made]


@cache
def _small_field(backend: str) -> RadianceField:
    config = FieldConfig(
        LEVELS, base=4, finest=16, log2_entries=8, hidden=8, geometry=3, backend=backend
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return RadianceField(config, torch.tensor([[0.0] * 3, [1.0] * 3]), Hooks().layer)
