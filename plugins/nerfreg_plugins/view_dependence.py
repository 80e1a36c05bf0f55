"""Colour changes slowly with the viewing direction.

Our own. NeRF++ (Zhang et al. 2020), section 3, says why it helps: a colour network that is free to
follow directions can hide a wrong shape from the few that were photographed.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, ClassVar, no_type_check

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerfreg import AffineLayer, Regularizer, WrappedLayer, hookimpl
from nerfreg.field.directions import DEGREES
from nerfreg.numerics import exact
from nerfreg_plugins.references import view_dependence as reference


def damping(inputs: int, scale: float) -> Float[Tensor, " inputs"]:
    """Return the factor of each input of the colour network.

    That is scale^l for harmonics of degree l, which come first, and 1 for what follows them.

    Args:
        inputs: How many inputs the network has.
        scale: The factor for each degree.
    """
    factors = torch.ones(inputs)
    factors[: len(DEGREES)] = scale ** torch.tensor(DEGREES, dtype=torch.float32)
    return factors


class Damped(WrappedLayer):
    """A layer that sees its inputs times some factors; affine if the layer inside is.

    Attributes:
        factors: Of each input, `(in,)`.
    """

    factors: Tensor

    def __init__(self, inner: nn.Module, factors: Float[Tensor, " inputs"]) -> None:
        super().__init__(inner)
        # They follow from the configuration, so that checkpoints need not hold them.
        self.register_buffer("factors", factors, persistent=False)

    def effective(self) -> tuple[Float[Tensor, "out in"], Float[Tensor, " out"] | None] | None:
        """Return the inner weight with its columns scaled, which computes the same."""
        # A shift that the inner layer adds to its input comes after the factors, while the kernels
        # would add it before: then `forward` has to run.
        if not isinstance(self.inner, AffineLayer) or self.inner.input_shift() is not None:
            return None
        affine = self.inner.effective()
        return None if affine is None else (affine[0] * self.factors, affine[1])

    def forward(self, x: Float[Tensor, "points in"]) -> Float[Tensor, "points out"]:
        """Apply the layer inside to the scaled input."""
        y: Tensor = self.inner(x * self.factors)
        return y


@dataclass
class ViewDependence(Regularizer):
    """Colour changes slowly with the viewing direction (our own).

    The harmonics are still there, so that highlights can be learned where the photographs insist
    on them; they only cost larger weights.

    Attributes:
        weight: There is no loss; 0 switches the damping off, anything else has no effect.
        scale: Harmonics of degree l reach the colour network times scale^l. 1 changes nothing, 0
            makes colour the same from everywhere.
    """

    scale: float = 0.1

    cite: ClassVar[str] = "zhang2020nerfpp"

    @hookimpl(wrapper=True)
    @no_type_check  # a checker that wraps the generator would hide it from pluggy
    def nerfreg_layer(
        self, network: str, index: int, in_features: int
    ) -> Generator[None, nn.Module, nn.Module]:
        layer = yield
        # A network with fewer inputs has no harmonics, so that there is nothing to damp.
        if network != "color" or index != 0 or in_features < len(DEGREES):
            return layer
        return Damped(layer, damping(in_features, self.scale))

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Damped) or not isinstance(given.inner, AffineLayer):
            return None
        affine = given.inner.effective()
        if affine is None:
            return None
        return {"weight": reference.damped(exact(affine[0]), exact(given.factors))}
