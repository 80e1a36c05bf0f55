"""Density and colour of a point, from an encoding, harmonics and two networks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from nerfreg.field.config import FieldConfig
from nerfreg.field.directions import WIDTH, spherical_harmonics
from nerfreg.field.grid import HashGrid
from nerfreg.field.grid_layout import FEATURES, GridLayout
from nerfreg.field.network import Network
from nerfreg.hooks import TrainedModule

LARGEST_LOG_DENSITY = 15.0
"""Bound of the exponent of density: e^15 per half box makes a thousandth of the box opaque."""

LayerFactory = Callable[[str, int, int, int, str], nn.Module]
"""Makes a layer from network, index, in_features, out_features and activation."""


@dataclass(frozen=True)
class FieldParts:
    """What plugins put into a field besides layers.

    Attributes:
        encoders: Encoders in place of the core's, of "positions" or "directions"; each has an
            attribute `width`.
        color_inputs: How many inputs of the colour network come from plugins.
    """

    encoders: Mapping[str, nn.Module] = field(default_factory=dict)
    color_inputs: int = 0


class RadianceField(nn.Module):
    """Maps positions in a box to density, and density features with a direction to colour.

    The architecture is that of instant-ngp (Mueller et al. 2022). Density is per world unit, but
    learned in units of half the box, so that a scene may have any scale.

    Attributes:
        grid: The hash grid over the cube around the box; None if a plugin made another encoder.
        encoder: The encoder of positions that a plugin made; None for the grid.
        direction_encoder: The encoder of directions that a plugin made; None for harmonics.
        plugins: The modules of plugins, by the names of the plugins.
        trained: The same with the settings of their training.
        bias: Added to the raw density before the exponential.
        half_box: Half the longest side of the box, in world units.
        center: Centre of the box, `(3,)`.
        density_network: From grid features to raw density and geometry features.
        color_network: From harmonics and geometry features to colour before the sigmoid.
    """

    center: Tensor

    def __init__(
        self,
        config: FieldConfig,
        box: Float[Tensor, "2 3"],
        make_layer: LayerFactory,
        parts: FieldParts | None = None,
    ) -> None:
        """Build grid and networks with fresh weights.

        Args:
            config: Sizes and implementations.
            box: Lower and upper corner of the modelled space.
            make_layer: Makes every layer of both networks.
            parts: What else plugins put into the field.
        """
        super().__init__()
        parts = parts or FieldParts()
        layout = GridLayout(config.levels, config.base, config.finest, config.log2_entries)
        self.encoder = parts.encoders.get("positions")
        self.grid = HashGrid(layout, config.backend) if self.encoder is None else None
        self.direction_encoder = parts.encoders.get("directions")
        self.density_width = _width(self.encoder, layout.features)
        self.direction_width = _width(self.direction_encoder, WIDTH)
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
            [self.density_width, *[hidden] * (config.density_layers - 1), 1 + geometry],
            make_layer,
            precision,
        )
        self.color_network = _build(
            "color",
            [
                self.direction_width + geometry + parts.color_inputs,
                *[hidden] * (config.color_layers - 1),
                3,
            ],
            make_layer,
            precision,
        )
        self.trained: dict[str, TrainedModule] = {}
        self.plugins = nn.ModuleDict()

    def add_plugin(self, name: str, trained: TrainedModule) -> None:
        """Make the module of a plugin a part of the field.

        Args:
            name: Name of the plugin.
            trained: The module, with the settings of its training.
        """
        self.trained[name] = trained
        # Names of torch's modules have no dots.
        self.plugins[name.replace(".", "_")] = trained.module

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

    def one_gradient(self) -> AbstractContextManager[None]:
        """Let all encodings inside the block add to one gradient (`HashGrid.one_gradient`)."""
        return nullcontext() if self.grid is None else self.grid.one_gradient()

    def same_gradient(self) -> AbstractContextManager[None]:
        """Let encodings inside the block add to that gradient (`HashGrid.same_gradient`)."""
        return nullcontext() if self.grid is None else self.grid.same_gradient()

    def unit(self, positions: Float[Tensor, "points 3"]) -> Float[Tensor, "points 3"]:
        """Map world positions to the unit cube that the encoder sees."""
        return (positions - self.center) / (2 * self.half_box) + 0.5

    def encode(
        self, unit: Float[Tensor, "points 3"], active: float | None = None
    ) -> tuple[Float[Tensor, "points features"], Float[Tensor, " width"] | None]:
        """Encode positions in the unit cube, as the first layer of the density network gets them.

        Args:
            unit: Positions in the unit cube, `(P, 3)`.
            active: Number of features that are alive, from the coarsest; None means all.

        Returns:
            The features that are alive, at least in part, and the factor of each of all features;
            None where all factors are 1.
        """
        width, scale = self.density_width, None
        alive = width
        if active is not None and active < width:
            # The fractional feature fades in, so that the loss does not jump.
            alive = math.ceil(max(active, 0))
            scale = (active - torch.arange(width, device=unit.device)).clamp(0, 1).to(unit.dtype)
        if self.grid is not None:
            # A level is evaluated if at least part of its first feature is alive.
            features: Tensor = self.grid(unit, math.ceil(alive / FEATURES))
        else:
            assert self.encoder is not None
            features = self.encoder(unit)
        return features, scale

    def encode_directions(self, directions: Float[Tensor, "*rays 3"]) -> Float[Tensor, "*rays out"]:
        """Encode unit directions."""
        if self.direction_encoder is None:
            return spherical_harmonics(directions)
        encoded: Tensor = self.direction_encoder(directions.reshape(-1, 3))
        return encoded.view(*directions.shape[:-1], self.direction_width)

    def encode_along(
        self,
        directions: Float[Tensor, "rays 3"] | Float[Tensor, "rays samples 3"],
        ray: Int[Tensor, " picked"],
        sample: Int[Tensor, " picked"],
    ) -> Float[Tensor, "picked width"]:
        """Encode the directions of some samples.

        Args:
            directions: (R, 3) of rays, or (R, N, 3) of their samples.
            ray: (K,) index of the ray.
            sample: (K,) index of the sample on it.
        """
        if directions.dim() == 2:
            # Computed once per ray and copied to its samples.
            return self.encode_directions(directions).index_select(0, ray)
        return self.encode_directions(directions[ray, sample])

    def raw_density(
        self,
        positions: Float[Tensor, "points 3"],
        active: float | None = None,
    ) -> Float[Tensor, "points out"]:
        """Evaluate the encoder and the density network.

        Args:
            positions: World positions, `(P, 3)`.
            active: Number of features that are alive, from the coarsest
                (`Samples.density_features`); None means all.

        Returns:
            The raw density and the features for the colour network, `(P, 1 + geometry)`.
        """
        features, scale = self.encode(self.unit(positions), active)
        raw: Tensor = self.density_network(features, scale)
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
        encoded: Float[Tensor, "points width"],
        active: float | None = None,
        more: Float[Tensor, "points inputs"] | None = None,
    ) -> Float[Tensor, "points 3"]:
        """Evaluate the colour network.

        Args:
            raw: Output of `raw_density`.
            encoded: Encoded viewing directions, `(P, direction_width)`.
            active: Number of their features that are alive (`Samples.color_features`); None means
                all.
            more: What plugins add to the input; None if they add nothing.

        Returns:
            Colours in [0, 1].
        """
        width = self.direction_width
        if active is not None and active < width:
            alive = (active - torch.arange(width, device=raw.device)).clamp(0, 1)
            encoded = encoded * alive
        # The raw density in between is no input of the network. It is left in as a gap
        # nevertheless: slicing it away would copy, and the backward products of the first layer run
        # twice as fast with 32 columns as with 31.
        inputs = [encoded, raw] if more is None else [encoded, raw, more]
        return torch.sigmoid(self.color_network(torch.cat(inputs, dim=1), gap=width))


def _width(encoder: Any, default: int) -> int:
    return default if encoder is None else int(encoder.width)


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
