"""Checks of the compositor itself, by the same cases as the plugins."""

from __future__ import annotations

import torch
from torch import Tensor

from nerfreg.checks.accuracy import not_finite_gradients, wrong_gradient
from nerfreg.checks.cases import Case
from nerfreg.checks.inputs import Inputs
from nerfreg.checks.report import Report
from nerfreg.numerics import not_finite
from nerfreg.rendering.compositing import composite
from nerfreg.rendering.reference import PARTS, composite_exactly

LIMITS = {"float32": 2e-5, "float64": 1e-11}


def check_compositing(report: Report, case: Case, inputs: Inputs) -> None:
    """Check that all parts and their gradients are finite, and the parts close to exact ones."""
    parts, leaves = _composite(inputs)
    wrong = [line for name, part in parts.items() for line in not_finite(name, part)]
    report.judge("value", wrong)
    if wrong:
        return
    for name, part in parts.items():
        named = zip(("density", "rgb"), leaves, strict=True)
        report.judge("gradient", not_finite_gradients(f"gradient of {name} by ", part, named))
    if report.spot.dtype in LIMITS:
        background = inputs.rays.background
        truth = composite_exactly(inputs.density, inputs.colors, inputs.t_edges, background)
        report.compare(parts, truth, limits=LIMITS)
    if case.differentiable(report.spot):
        report.judge("gradient", wrong_gradient(_mean, inputs))


def _composite(inputs: Inputs) -> tuple[dict[str, Tensor], list[Tensor]]:
    density = inputs.density.clone().requires_grad_()
    colors = inputs.colors.clone().requires_grad_()
    made = composite(density, colors, inputs.t_edges, inputs.rays.background)
    return {part: getattr(made, part) for part in PARTS}, [density, colors]


def _mean(inputs: Inputs) -> tuple[Tensor, list[Tensor]]:
    """One number from all parts, depth in units of the scene."""
    parts, leaves = _composite(inputs)
    near, far = inputs.bounds
    squares, depth = parts["weights"].square(), parts["depth"] / (far - near)
    numbers = squares, parts["log_transmittance"], depth, parts["rgb"]
    return torch.stack([part.mean() for part in numbers]).sum(), leaves
