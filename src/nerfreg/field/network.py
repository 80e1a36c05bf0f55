"""A small network of layers made by the layer factory, with fused kernels for affine layers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from nerfreg.field.fused import FusedNetwork
from nerfreg.field.layers import AffineLayer, shifted


class Network(nn.Module):
    """Layers one after the other; each applies its own activation.

    Attributes:
        layers: The layers, from the input to the output.
        precision: The type in which the fused path computes all layers but the last. The plain path
            keeps the type of the input.
    """

    def __init__(self, layers: list[nn.Module], precision: torch.dtype = torch.float32) -> None:
        """Take over the layers."""
        super().__init__()
        self.layers = nn.ModuleList(layers)
        self.precision = precision

    def forward(
        self,
        x: Float[Tensor, "points in"],
        scale: Float[Tensor, " all"] | None = None,
        gap: int | None = None,
        plain: bool = False,
    ) -> Float[Tensor, "points out"]:
        """Evaluate the network.

        Args:
            x: The inputs, `(P, in)`. They may be narrower than the first layer; the missing
                features count as 0 and cost nothing.
            scale: A factor for each input feature of the first layer.
            gap: A column of `x` that the first layer does not have and that is ignored.
            plain: Whether to use autograd even where the fused path could run. Other devices than
                the CPU always do.

        Returns:
            The outputs, `(P, out)`.
        """
        affine = None if plain or x.device.type != "cpu" else self._affine()
        if affine is None:
            return self._plain(_without(x, gap), scale)
        first, last = self.layers[0], self.layers[-1]
        assert isinstance(first, AffineLayer) and isinstance(last, AffineLayer)
        # Gap, missing features and scale all become part of the first weight, which has a few
        # thousand numbers, instead of copies of x, which has millions. Autograd takes the gradient
        # back through the same steps.
        weights = list(affine)
        if (shift := first.input_shift()) is not None:
            # A shift applies to what the layer sees, after scaling, and in all its columns: then x
            # has to be made after all.
            x, scale, gap = _scaled(_without(x, gap), scale) + shift, None, None
        if gap is not None:
            known = weights[0]
            weights[0] = torch.cat(
                [known[:, :gap], known.new_zeros(len(known), 1), known[:, gap:]], dim=1
            )
        used = weights[0][:, : x.shape[1]]
        weights[0] = used if scale is None else used * scale[: x.shape[1]]
        activations = tuple(layer.activation for layer in self.layers)
        apply: Callable[..., Tensor] = FusedNetwork.apply
        return shifted(apply(x, activations, self._precision(x), *weights), last.output_shift())

    def _affine(self) -> list[Any] | None:
        """Weight and bias of every layer in turn; None where the fused kernels cannot run.

        They cannot if a layer is not affine now, if the last layer has an activation, or if
        something is added between two layers.
        """
        # The backward pass takes the gradient of the output for that of the last affine map.
        if getattr(self.layers[-1], "activation", "none") != "none":
            return None
        parts: list[Any] = []
        for layer in self.layers:
            if not isinstance(layer, AffineLayer) or _shifts_inside(self.layers, layer):
                return None
            effective = layer.effective()
            if effective is None:
                return None
            parts.extend(effective)
        return parts

    def _precision(self, x: Tensor) -> torch.dtype:
        # Only float32 is lowered: a network that is checked in float64 must stay there.
        return self.precision if x.dtype == torch.float32 else x.dtype

    def _plain(self, x: Tensor, scale: Tensor | None) -> Tensor:
        x = _scaled(x, scale)
        for layer in self.layers:
            x = layer(x)
        return x


def _shifts_inside(layers: nn.ModuleList, layer: AffineLayer) -> bool:
    """Whether the layer adds something in between, neither at the input nor at the output."""
    before = layer is not layers[0] and layer.input_shift() is not None
    return before or (layer is not layers[-1] and layer.output_shift() is not None)


def _without(x: Tensor, column: int | None) -> Tensor:
    return x if column is None else torch.cat([x[:, :column], x[:, column + 1 :]], dim=1)


def _scaled(x: Tensor, scale: Tensor | None) -> Tensor:
    """The features times their factors, with zeros for those that are missing."""
    return (
        x
        if scale is None
        else functional.pad(x * scale[: x.shape[1]], (0, len(scale) - x.shape[1]))
    )
