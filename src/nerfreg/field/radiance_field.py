"""Density and colour of a point: hash grid, spherical harmonics and the two networks (Mueller et al. 2022)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerfreg.field.config import FieldConfig
from nerfreg.field.directions import WIDTH
from nerfreg.field.grid import HashGrid
from nerfreg.field.grid_layout import FEATURES, GridLayout
from nerfreg.field.network import Network

LARGEST_LOG_DENSITY = 15.0
LayerFactory = Callable[[str, int, int, int, str], nn.Module]


class RadianceField(nn.Module):
    """Maps positions in a box to density, and density features with a direction to colour.

    make_layer: (network, index, in_features, out_features, activation) -> layer.
    Density is per world unit, but learned in units of half the box, so that a scene may have any scale.
    """

    center: Tensor

    def __init__(
        self, config: FieldConfig, box: Float[Tensor, "2 3"], make_layer: LayerFactory
    ) -> None:
        super().__init__()
        layout = GridLayout(config.levels, config.base, config.finest, config.log2_entries)
        self.grid = HashGrid(layout, config.backend)
        self.bias = config.density_bias
        self.half_box = float((box[1] - box[0]).max()) / 2
        self.register_buffer("center", box.mean(dim=0), persistent=False)
        geometry, hidden, precision = (
            config.geometry,
            config.hidden,
            getattr(torch, config.precision),
        )
        self.density_network = _build(
            "density",
            [layout.features, *[hidden] * (config.density_layers - 1), 1 + geometry],
            make_layer,
            precision,
        )
        self.color_network = _build(
            "color",
            [WIDTH + geometry, *[hidden] * (config.color_layers - 1), 3],
            make_layer,
            precision,
        )

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """What is evaluated inside the block has no gradient by the weights, and costs less backward."""
        trained = [parameter for parameter in self.parameters() if parameter.requires_grad]
        for parameter in trained:
            parameter.requires_grad_(False)
        try:
            yield
        finally:
            for parameter in trained:
                parameter.requires_grad_(True)

    def raw_density(
        self, positions: Float[Tensor, "points 3"], active: float | None = None
    ) -> Float[Tensor, "points out"]:
        """Output of the density network, (P, 1 + geometry): raw density, then what the colour network gets.

        active: how many grid features are alive (`Samples.density_features`); None means all.
        """
        layout = self.grid.layout
        unit = (positions - self.center) / (2 * self.half_box) + 0.5
        levels, scale = layout.levels, None
        if active is not None and active < layout.features:
            levels = math.ceil(max(active, 0) / FEATURES)
            scale = (
                (active - torch.arange(layout.features, device=unit.device))
                .clamp(0, 1)
                .to(unit.dtype)
            )
        return self.density_network(self.grid(unit, levels), scale)

    def density(self, raw: Float[Tensor, "*points out"]) -> Float[Tensor, "*points"]:
        """exp(raw density + bias) per world unit.

        The exponent is clipped at 15, where a thousandth of the box is opaque; its gradient is not, so that a
        density beyond can come back.
        """
        exponent = raw[..., 0] + self.bias
        excess = (exponent.detach() - LARGEST_LOG_DENSITY).clamp_min(0)
        return torch.exp(exponent - excess) / self.half_box

    def color(
        self,
        raw: Float[Tensor, "points out"],
        harmonics: Float[Tensor, "points 16"],
        active: float | None = None,
    ) -> Float[Tensor, "points 3"]:
        """Colour in [0, 1] from the output of the density network and the harmonics of the viewing direction.

        active: how many harmonics are alive (`Samples.color_features`); None means all.
        """
        if active is not None and active < WIDTH:
            alive = (active - torch.arange(WIDTH, device=raw.device)).clamp(0, 1)
            harmonics = harmonics * alive
        # The raw density in between is no input; products of 32 columns are faster than those of 31, and slices copy.
        return torch.sigmoid(self.color_network(torch.cat([harmonics, raw], dim=1), gap=WIDTH))


def _build(
    network: str, widths: list[int], make_layer: LayerFactory, precision: torch.dtype
) -> Network:
    last = len(widths) - 2
    return Network(
        [
            make_layer(network, i, widths[i], widths[i + 1], "none" if i == last else "relu")
            for i in range(len(widths) - 1)
        ],
        precision,
    )
