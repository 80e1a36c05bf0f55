"""Colour changes slowly with the viewing direction. Our own. NeRF++ (Zhang et al. 2020), section 3, says why it helps:
a colour network that is free to follow directions can hide a wrong shape from the few that were photographed."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, ClassVar, no_type_check

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerfreg import Regularizer, hookimpl
from nerfreg.field.directions import DEGREES
from nerfreg.field.layers import AffineLayer
from nerfreg.numerics import exact


def damping(inputs: int, scale: float) -> Float[Tensor, " inputs"]:
    """The factor of each input of the colour network: scale^l for harmonics of degree l, 1 for what follows them."""
    factors = torch.ones(inputs)
    factors[: len(DEGREES)] = scale ** torch.tensor(DEGREES, dtype=torch.float32)
    return factors


class Damped(AffineLayer):
    """A layer that sees its inputs times some factors; affine if the layer inside is."""

    factors: Tensor

    def __init__(self, inner: nn.Module, factors: Float[Tensor, " inputs"]) -> None:
        super().__init__(getattr(inner, "activation", "none"))
        self.inner = inner
        self.register_buffer("factors", factors, persistent=False)

    def effective(self) -> tuple[Float[Tensor, "out in"], Float[Tensor, " out"] | None] | None:
        if not isinstance(self.inner, AffineLayer) or self.inner.input_shift() is not None:
            return None
        affine = self.inner.effective()
        return None if affine is None else (affine[0] * self.factors, affine[1])

    def output_shift(self) -> Float[Tensor, "points out"] | None:
        return self.inner.output_shift() if isinstance(self.inner, AffineLayer) else None

    def forward(self, x: Float[Tensor, "points in"]) -> Float[Tensor, "points out"]:
        y: Tensor = self.inner(x * self.factors)
        return y


@dataclass
class ViewDependence(Regularizer):
    """Colour changes slowly with the viewing direction (our own).

    scale: harmonics of degree l reach the colour network times scale^l; 1 changes nothing, and 0 makes colour the same
    from everywhere.
    """

    scale: float = 0.1

    cite: ClassVar[str] = "zhang2020nerfpp"

    @hookimpl(wrapper=True)
    @no_type_check  # a checker that wraps the generator would hide it from pluggy
    def nerfreg_layer(
        self, network: str, index: int, in_features: int
    ) -> Generator[None, nn.Module, nn.Module]:
        layer = yield
        if network != "color" or index != 0 or in_features < len(DEGREES):
            return layer
        return Damped(layer, damping(in_features, self.scale))

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        affine = (
            given.inner.effective()
            if isinstance(given, Damped) and isinstance(given.inner, AffineLayer)
            else None
        )
        if affine is None:
            return None
        factors = exact(given.factors)
        rows = [
            [w * factor for w, factor in zip(row, factors, strict=True)] for row in exact(affine[0])
        ]
        return {"weight": rows}
