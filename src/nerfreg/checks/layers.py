"""Checks of `nerfreg_layer`: weights and trainable scalars that training should never reach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import nn

from nerfreg.checks.accuracy import not_finite_gradients
from nerfreg.checks.cases import CASES
from nerfreg.checks.driver import Driver
from nerfreg.checks.inputs import DTYPES, cast
from nerfreg.checks.report import LIMITS, Report, Spot
from nerfreg.field.layers import ACTIVATIONS, AffineLayer
from nerfreg.numerics import not_finite
from nerfreg.training.contracts import wrong_layer

ROWS = (0.0, 1e-30, 1e30)
"""Every number of the first rows of each matrix; the other rows stay as they were initialised."""

POINTS = 16


@dataclass(frozen=True)
class LayerCase:
    """Layers whose trainable scalars are all set to one value; None leaves them as initialised."""

    name: str
    description: str
    scalar: float | None

    def points(self, dtypes: Sequence[str], samples: int | None) -> Iterator[tuple[Spot, None]]:
        """Yield every precision that has a limit; there are no samples."""
        yield from ((Spot(self.name, dtype), None) for dtype in dtypes if dtype in LIMITS)


_INITIAL = "layers: rows of 0, 1e-30 and 1e30, trainable scalars as initialised"
LAYER_CASES = (
    LayerCase("layer_initial", _INITIAL, None),
    LayerCase("layer_-50", "layers: the same rows, trainable scalars at -50", -50.0),
    LayerCase("layer_0", "layers: the same rows, trainable scalars at 0", 0.0),
    LayerCase("layer_50", "layers: the same rows, trainable scalars at 50", 50.0),
    LayerCase("layer_1e4", "layers: the same rows, trainable scalars at 1e4", 1e4),
)


def check_layers(report: Report, case: LayerCase, _: None) -> None:
    """Check that every layer has finite outputs and gradients, and computes what it tells."""
    dtype = DTYPES[report.spot.dtype]
    driver = Driver(report.subject, cast(CASES[0].build(2), dtype))
    for network, widths in driver.widths.items():
        layers = zip(driver.networks[network].layers, pairwise(widths), strict=True)
        for index, (layer, shape) in enumerate(layers):
            name = f"layer {index} of {network}"
            wrong = wrong_layer(layer.float(), *shape)
            report.judge("contract", [f"{name}: {line}" for line in wrong])
            _stress(layer.to(dtype), case.scalar)
            _check_layer(report, driver, name, layer, shape[0])
    driver.keep_contract(driver.step())
    report.judge("contract", driver.broken_promises())


def _check_layer(report: Report, driver: Driver, name: str, layer: nn.Module, width: int) -> None:
    probe = torch.rand(POINTS, width, generator=torch.Generator().manual_seed(0))
    output = layer(probe := probe.to(DTYPES[report.spot.dtype]))
    report.judge("value", not_finite(f"output of {name}", output))
    if output.requires_grad:
        leaves = ((f"{part} in {name}", value) for part, value in layer.named_parameters())
        report.judge("gradient", not_finite_gradients("gradient of ", output, leaves))
    affine = layer.effective() if isinstance(layer, AffineLayer) else None
    if affine is None:
        return
    with torch.no_grad():
        expected = ACTIVATIONS[str(layer.activation)](nn.functional.linear(probe, *affine))
    alike = torch.allclose(output.detach(), expected, rtol=1e-5, atol=1e-6, equal_nan=True)
    unlike = f"{name}: its output is not that of its effective weight and bias"
    report.judge("contract", [] if alike else [unlike])
    parts = dict(zip(("weight", "bias"), affine, strict=True))
    report.compare(parts, driver.reference(layer), f"{{}} of {name}")


@torch.no_grad()
def _stress(layer: nn.Module, scalar: float | None) -> None:
    for parameter in layer.parameters():
        if parameter.ndim == 0 and scalar is not None:
            parameter.fill_(scalar)
        elif parameter.ndim == 2:
            for row, value in zip(parameter, ROWS, strict=False):
                row.fill_(value)
