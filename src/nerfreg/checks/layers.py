"""Checks of `nerfreg_layer`: trainable scalars and rows of a weight set to what training should never bring them to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerfreg.checks.cases import CASES
from nerfreg.checks.driver import FEATURES, GEOMETRY, HIDDEN, Driver
from nerfreg.checks.exact import relative_error
from nerfreg.checks.inputs import DTYPES
from nerfreg.checks.losses import broken_promises
from nerfreg.checks.report import LIMITS, Report, Spot
from nerfreg.checks.subject import Subject
from nerfreg.field.layers import ACTIVATIONS, AffineLayer
from nerfreg.numerics import not_finite
from nerfreg.training.contracts import wrong_layer

ROWS = (0.0, 1e-30, 1e30)
"""Every number of the first rows of each matrix; the rows behind them stay as they were initialised."""

POINTS = 16


@dataclass(frozen=True)
class LayerCase:
    """scalar: what every trainable scalar is set to; None leaves it."""

    name: str
    description: str
    scalar: float | None


LAYER_CASES = (
    LayerCase(
        "layer_initial", "layers: rows of 0, 1e-30 and 1e30, trainable scalars as initialised", None
    ),
    LayerCase("layer_-50", "layers: the same rows, trainable scalars at -50", -50.0),
    LayerCase("layer_0", "layers: the same rows, trainable scalars at 0", 0.0),
    LayerCase("layer_50", "layers: the same rows, trainable scalars at 50", 50.0),
    LayerCase("layer_1e4", "layers: the same rows, trainable scalars at 1e4", 1e4),
)


def check_layers(report: Report, subject: Subject, case: LayerCase, spot: Spot) -> None:
    """Outputs and gradients of every layer are finite, and what it says it computes is what it computes."""
    driver = Driver(CASES[0].build(2).to(DTYPES[spot.dtype]), subject.hooks(), subject.name)
    for name, layer, shape in _layers(driver):
        report.judge(
            "contract", spot, [f"{name}: {line}" for line in wrong_layer(layer.float(), *shape)]
        )
        layer.to(DTYPES[spot.dtype])
        _stress(layer, case)
        probe = torch.rand(POINTS, shape[0], generator=torch.Generator().manual_seed(0)).to(
            DTYPES[spot.dtype]
        )
        output = layer(probe)
        report.judge("value", spot, not_finite(f"output of {name}", output))
        if output.requires_grad:
            report.judge("gradient", spot, _wrong_gradients(name, layer, output))
        report.judge("contract", spot, _wrong_effective(name, layer, probe, output.detach()))
        truth = driver.hooks.reference(subject.name, layer, driver.step())
        effective = layer.effective() if isinstance(layer, AffineLayer) else None
        for part, values in zip(("weight", "bias"), effective or (), strict=False):
            if part in truth and values is not None:
                error = relative_error(values, truth[part], spot.dtype)
                report.measure(f"{part} of {name}", spot, error, LIMITS[spot.dtype])
    driver.keep_contract(driver.step())
    report.judge("contract", spot, broken_promises(driver))


def _layers(driver: Driver) -> Iterator[tuple[str, nn.Module, tuple[int, int]]]:
    """Name, layer, and its width before and behind."""
    networks = (
        ("density", driver.density_network, (FEATURES, HIDDEN, 1 + GEOMETRY)),
        ("color", driver.color_network, (3 + GEOMETRY, HIDDEN, 3)),
    )
    for network, module, widths in networks:
        for index, (layer, shape) in enumerate(zip(module.layers, pairwise(widths), strict=True)):
            yield f"layer {index} of {network}", layer, shape


@torch.no_grad()
def _stress(layer: nn.Module, case: LayerCase) -> None:
    for parameter in layer.parameters():
        if parameter.ndim == 0 and case.scalar is not None:
            parameter.fill_(case.scalar)
        elif parameter.ndim == 2:
            for row, value in zip(parameter, ROWS, strict=False):
                row.fill_(value)


def _wrong_gradients(name: str, layer: nn.Module, output: Float[Tensor, "points out"]) -> list[str]:
    parameters = dict(layer.named_parameters())
    grads = torch.autograd.grad(output.sum(), list(parameters.values()), allow_unused=True)
    found = zip(parameters, grads, strict=True)
    return [
        line
        for parameter, grad in found
        if grad is not None
        for line in not_finite(f"gradient of {parameter} in {name}", grad)
    ]


def _wrong_effective(
    name: str,
    layer: nn.Module,
    probe: Float[Tensor, "points in"],
    output: Float[Tensor, "points out"],
) -> list[str]:
    affine = layer.effective() if isinstance(layer, AffineLayer) else None
    if affine is None:
        return []
    activation = ACTIVATIONS[str(layer.activation)]
    with torch.no_grad():
        expected = activation(nn.functional.linear(probe, *affine))
    if torch.allclose(output, expected, rtol=1e-5, atol=1e-6, equal_nan=True):
        return []
    return [f"{name}: its output is not that of its effective weight and bias"]
