"""Checks of the compositor itself, by the same cases as the plugins."""

from __future__ import annotations

import torch
from torch import Tensor

from nerfreg.checks.cases import SIZES, Case
from nerfreg.checks.exact import composite_exactly, relative_error
from nerfreg.checks.gradients import wrong_gradient
from nerfreg.checks.inputs import Inputs
from nerfreg.checks.report import Report, Spot
from nerfreg.numerics import not_finite
from nerfreg.rendering.compositing import Composite, composite

NAME = "compositing"
LIMITS = {"float32": 2e-5, "float64": 1e-11}
PARTS = ("weights", "log_transmittance", "opacity", "depth", "rgb")


def check_compositing(report: Report, case: Case, inputs: Inputs, spot: Spot) -> None:
    """Every part is finite, with finite gradients, and close to its exact value."""
    density, colors = (
        inputs.density.clone().requires_grad_(),
        inputs.colors.clone().requires_grad_(),
    )
    result = composite(density, colors, inputs.t_edges, inputs.rays.background)
    wrong = [line for part in PARTS for line in not_finite(part, getattr(result, part))]
    report.judge("value", spot, wrong)
    if wrong:
        return
    for part in PARTS:
        grads = torch.autograd.grad(
            getattr(result, part).sum(),
            [density, colors],
            retain_graph=True,
            allow_unused=True,
            materialize_grads=True,
        )
        found = [
            not_finite(name, grad) for name, grad in zip(("density", "rgb"), grads, strict=True)
        ]
        report.judge(
            "gradient", spot, [f"gradient of {part} by {line}" for lines in found for line in lines]
        )
    if spot.dtype in LIMITS:
        truth = composite_exactly(
            inputs.density, inputs.colors, inputs.t_edges, inputs.rays.background
        )
        for part in PARTS:
            error = relative_error(
                getattr(result, part), [getattr(ray, part) for ray in truth], spot.dtype
            )
            report.measure(part, spot, error, LIMITS[spot.dtype])
    if case.regular and spot.dtype == "float64" and spot.samples in SIZES:
        report.judge("gradient", spot, wrong_gradient(_mean, inputs))


def _mean(inputs: Inputs) -> tuple[Tensor, list[Tensor]]:
    """One number from all parts, depth in units of the scene."""
    density, colors = (
        inputs.density.clone().requires_grad_(),
        inputs.colors.clone().requires_grad_(),
    )
    result: Composite = composite(density, colors, inputs.t_edges, inputs.rays.background)
    assert result.rgb is not None
    near, far = inputs.bounds
    parts = (
        result.weights.square(),
        result.log_transmittance,
        result.depth / (far - near),
        result.rgb,
    )
    return torch.stack([part.mean() for part in parts]).sum(), [density, colors]
