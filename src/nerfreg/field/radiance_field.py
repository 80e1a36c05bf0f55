"""Density and colour of a point, from hash grid, spherical harmonics and two networks."""

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
"""Bound of the exponent of density: e^15 per half box makes a thousandth of the box opaque."""

LayerFactory = Callable[[str, int, int, int, str], nn.Module]
"""Makes a layer from network, index, in_features, out_features and activation."""


class RadianceField(nn.Module):
    """Maps positions in a box to density, and density features with a direction to colour.

    The architecture is that of instant-ngp (Mueller et al. 2022). Density is per world unit, but
    learned in units of half the box, so that a scene may have any scale.

    Attributes:
        grid: The hash grid over the cube around the box.
        bias: Added to the raw density before the exponential.
        half_box: Half the longest side of the box, in world units.
        center: Centre of the box, `(3,)`.
        density_network: From grid features to raw density and geometry features.
        color_network: From harmonics and geometry features to colour before the sigmoid.
    """

    center: Tensor

    def __init__(
        self, config: FieldConfig, box: Float[Tensor, "2 3"], make_layer: LayerFactory
    ) -> None:
        """Build grid and networks with fresh weights.

        Args:
            config: Sizes and implementations.
            box: Lower and upper corner of the modelled space.
            make_layer: Makes every layer of both networks.
        """
        super().__init__()
        layout = GridLayout(config.levels, config.base, config.finest, config.log2_entries)
        self.grid = HashGrid(layout, config.backend)
        self.bias = config.density_bias
        # One scale for all axes: a cell of the grid is a cube, whatever the shape of the box.
        self.half_box = float((box[1] - box[0]).max()) / 2
        # A buffer, so that it moves with the module; the scene gives it, so no checkpoint holds it.
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
        """Leave out the gradient by the weights of what is evaluated inside the block.

        The backward pass to the inputs then costs less.
        """
        # Only what was trained is restored: a plugin may have frozen parameters for good.
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
        """Evaluate the grid and the density network.

        Args:
            positions: World positions, `(P, 3)`.
            active: Number of grid features that are alive, from the coarsest
                (`Samples.density_features`); None means all.

        Returns:
            The raw density and the features for the colour network, `(P, 1 + geometry)`.
        """
        layout = self.grid.layout
        unit = (positions - self.center) / (2 * self.half_box) + 0.5
        levels, scale = layout.levels, None
        if active is not None and active < layout.features:
            # A level is evaluated if at least part of its first feature is alive; the fractional
            # feature fades in, so that the loss does not jump.
            levels = math.ceil(max(active, 0) / FEATURES)
            scale = (
                (active - torch.arange(layout.features, device=unit.device))
                .clamp(0, 1)
                .to(unit.dtype)
            )
        raw: Tensor = self.density_network(self.grid(unit, levels), scale)
        return raw

    def density(self, raw: Float[Tensor, "*points out"]) -> Float[Tensor, "*points"]:
        """Compute density per world unit, exp(raw density + bias) in units of half the box.

        Args:
            raw: Output of `raw_density`.

        Returns:
            The densities. The exponent is clipped at `LARGEST_LOG_DENSITY`.
        """
        exponent = raw[..., 0] + self.bias
        # Subtracting a constant and not clamping: the gradient is that of the clipped value and not
        # 0, so that a density beyond the bound can come back.
        excess = (exponent.detach() - LARGEST_LOG_DENSITY).clamp_min(0)
        return torch.exp(exponent - excess) / self.half_box

    def color(
        self,
        raw: Float[Tensor, "points out"],
        harmonics: Float[Tensor, "points 16"],
        active: float | None = None,
    ) -> Float[Tensor, "points 3"]:
        """Evaluate the colour network.

        Args:
            raw: Output of `raw_density`.
            harmonics: Spherical harmonics of the viewing directions.
            active: Number of harmonics that are alive (`Samples.color_features`); None means all.

        Returns:
            Colours in [0, 1].
        """
        if active is not None and active < WIDTH:
            alive = (active - torch.arange(WIDTH, device=raw.device)).clamp(0, 1)
            harmonics = harmonics * alive
        # The raw density in between is no input of the network. It is left in as a gap
        # nevertheless: slicing it away would copy, and the backward products of the first layer run
        # twice as fast with 32 columns as with 31.
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
