"""Lipschitz layers with a trainable bound.

Source: Liu et al. 2022, on both networks of a NeRF in CombiNeRF (Bonotto et al. 2024).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum, auto
from typing import Any, ClassVar

import mpmath
import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerfreg import Regularizer, Rendering, hookimpl
from nerfreg.field.layers import AffineLayer
from nerfreg.numerics import exact, single
from nerfreg_plugins.references import lipschitz as reference


def normalize_rows(
    weight: Float[Tensor, "out in"], k: Float[Tensor, ""]
) -> Float[Tensor, "out in"]:
    """Return the rows of W scaled by min(1, softplus(k) / sum abs(row)).

    No row then sums to more than softplus(k) in absolute value, which makes the layer
    softplus(k)-Lipschitz in the maximum norm. Rows within the bound, rows of zeros among them, stay
    exactly as they are.

    Args:
        weight: W, `(out, in)`.
        k: The layer's trainable parameter, a scalar.
    """
    bound, full = softplus(single(k)), single(weight)
    # In units of the largest entry no sum overflows, and no share of it underflows before the bound
    # multiplies it. The unit cancels, so that it needs no gradient.
    largest = full.detach().abs().amax(-1, keepdim=True)
    unit = full / torch.where(largest > 0, largest, 1.0)
    row_sum = unit.abs().sum(-1, keepdim=True)
    beyond = row_sum * largest > bound
    bounded = unit / torch.where(beyond, row_sum, 1.0) * bound
    return torch.where(beyond, bounded, full).to(weight.dtype)


def softplus(k: Float[Tensor, ""]) -> Float[Tensor, ""]:
    """Return log(1 + exp(k)), without the linear shortcut that torch's own takes for large k."""
    return torch.logaddexp(k, torch.zeros_like(k))


class LipschitzLinear(AffineLayer):
    """A linear layer whose effective weight is `normalize_rows(weight, k)`.

    Attributes:
        weight: W before it is scaled, `(out, in)`, initialised as torch does.
        bias: `(out,)` or None.
        k: A trainable scalar; softplus(k) is the bound.
    """

    def __init__(
        self, in_features: int, out_features: int, activation: str, bias: bool = False
    ) -> None:
        super().__init__(activation)
        linear = nn.Linear(in_features, out_features, bias=bias)
        self.weight = linear.weight
        self.bias = linear.bias
        # Twice the largest row sum, so that the bound starts out inactive: softplus(k) > k.
        self.k = nn.Parameter(2 * linear.weight.detach().abs().sum(-1).max())

    def effective(self) -> tuple[Float[Tensor, "out in"], Float[Tensor, " out"] | None]:
        """Return the scaled weight, and the bias."""
        return normalize_rows(self.weight, self.k), self.bias


class BoundedNetwork(StrEnum):
    """Which networks are bounded."""

    density = auto()
    color = auto()


class Activation(StrEnum):
    """What stands between the layers of a bounded network."""

    relu = auto()
    gelu = auto()


@dataclass
class Lipschitz(Regularizer):
    """Layers with a trainable Lipschitz bound (Liu et al. 2022, CombiNeRF).

    Attributes:
        networks: Which networks are bounded; `[color]` is CombiNeRF's sharp variant.
        bias: Give the bounded layers a bias, as CombiNeRF's program does.
        hidden_activation: Activation between the bounded layers; CombiNeRF's program has `gelu`.
        bound_weight: Weight of the product of all bounds as a loss term. Without the term, nothing
            but the photographs moves the bounds.
    """

    networks: list[BoundedNetwork] = field(
        default_factory=lambda: [BoundedNetwork.density, BoundedNetwork.color]
    )
    bias: bool = False
    hidden_activation: Activation = Activation.relu
    bound_weight: float = 0.0

    cite: ClassVar[str] = "liu2022lipschitz"

    def __post_init__(self) -> None:
        self._layers: dict[tuple[str, int], LipschitzLinear] = {}

    @hookimpl
    def nerfreg_layer(
        self, network: str, index: int, in_features: int, out_features: int, activation: str
    ) -> LipschitzLinear | None:
        if network not in self.networks:
            return None
        # The last layer has no activation, whatever the hidden ones have.
        own = str(self.hidden_activation) if activation == "relu" else activation
        layer = LipschitzLinear(in_features, out_features, own, self.bias)
        self._layers[network, index] = layer
        return layer

    @hookimpl
    def nerfreg_loss(self) -> dict[str, Float[Tensor, ""]]:
        if self.bound_weight == 0 or not self._layers:
            return {}
        bounds = torch.stack([softplus(layer.k) for layer in self._layers.values()])
        return {"lipschitz": self.bound_weight * bounds.prod()}

    @property
    def scale_free(self) -> bool:
        """True, since the loss sees nothing but the bounds."""
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if isinstance(given, LipschitzLinear):
            return {"weight": reference.normalize_rows(exact(given.weight), exact(given.k))}
        if not isinstance(given, Rendering) or self.bound_weight == 0 or not self._layers:
            return None
        bounds = [reference.softplus(exact(layer.k)) for layer in self._layers.values()]
        return {"lipschitz": self.bound_weight * mpmath.fprod(bounds)}

    @hookimpl
    def nerfreg_contract(self) -> dict[str, float]:
        """Promise that no row of an effective weight sums to more than its bound.

        The excess is relative to the bound.
        """
        broken = {}
        for (network, index), layer in self._layers.items():
            bound = float(reference.softplus(exact(layer.k)))
            largest = float(layer.effective()[0].detach().double().abs().sum(-1).max())
            # A bound that underflows to 0 leaves nothing to be relative to.
            excess = max(largest / bound - 1, 0.0) if bound > 0 else largest
            broken[f"rows of {network} {index}"] = excess
        return broken
