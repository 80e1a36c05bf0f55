"""Lipschitz layers with a trainable bound. Source: Liu et al. 2022, on both networks of a NeRF in CombiNeRF."""

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


def normalize_rows(
    weight: Float[Tensor, "out in"], k: Float[Tensor, ""]
) -> Float[Tensor, "out in"]:
    """Rows of W scaled by min(1, softplus(k) / sum abs(row)): no row sums to more than softplus(k).

    weight: (out, in). k: scalar. The layer is then softplus(k)-Lipschitz in the maximum norm. Rows within the bound,
    rows of zeros among them, stay exactly as they are.
    """
    bound, full = softplus(single(k)), single(weight)
    # In units of the largest entry no sum overflows, and no share of it underflows before the bound multiplies it.
    largest = full.detach().abs().amax(-1, keepdim=True)
    unit = full / torch.where(largest > 0, largest, 1.0)
    row_sum = unit.abs().sum(-1, keepdim=True)
    beyond = row_sum * largest > bound
    bounded = unit / torch.where(beyond, row_sum, 1.0) * bound
    return torch.where(beyond, bounded, full).to(weight.dtype)


def softplus(k: Float[Tensor, ""]) -> Float[Tensor, ""]:
    """log(1 + exp(k)), without the linear shortcut that torch's own takes for large k."""
    return torch.logaddexp(k, torch.zeros_like(k))


class LipschitzLinear(AffineLayer):
    """A linear layer whose effective weight is `normalize_rows(weight, k)`.

    Initialised as torch does, and k as twice the largest row sum, so that the bound starts out inactive.
    """

    def __init__(
        self, in_features: int, out_features: int, activation: str, bias: bool = False
    ) -> None:
        super().__init__(activation)
        linear = nn.Linear(in_features, out_features, bias=bias)
        self.weight = linear.weight
        self.bias = linear.bias
        self.k = nn.Parameter(2 * linear.weight.detach().abs().sum(-1).max())

    def effective(self) -> tuple[Float[Tensor, "out in"], Float[Tensor, " out"] | None]:
        return normalize_rows(self.weight, self.k), self.bias


class Network(StrEnum):
    """Which networks are bounded."""

    density = auto()
    color = auto()


class Activation(StrEnum):
    """Between the layers of a bounded network."""

    relu = auto()
    gelu = auto()


@dataclass
class Lipschitz(Regularizer):
    """Layers with a trainable Lipschitz bound (Liu et al. 2022, CombiNeRF).

    networks: which ones are bounded (`[color]` is the paper's sharp variant). bias, hidden_activation: what the
    bounded networks have beside their weights. bound_weight: weight of the product of all bounds as a loss term.
    """

    networks: list[Network] = field(default_factory=lambda: [Network.density, Network.color])
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
        own = str(self.hidden_activation) if activation == "relu" else activation
        layer = self._layers[network, index] = LipschitzLinear(
            in_features, out_features, own, self.bias
        )
        return layer

    @hookimpl
    def nerfreg_loss(self) -> dict[str, Float[Tensor, ""]]:
        if self.bound_weight == 0 or not self._layers:
            return {}
        bounds = torch.stack([softplus(layer.k) for layer in self._layers.values()])
        return {"lipschitz": self.bound_weight * bounds.prod()}

    @property
    def scale_free(self) -> bool:
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if isinstance(given, Rendering):
            bounds = [_bound(layer) for layer in self._layers.values()]
            return (
                {"lipschitz": self.bound_weight * mpmath.fprod(bounds)}
                if self.bound_weight and bounds
                else None
            )
        if not isinstance(given, LipschitzLinear):
            return None
        bound, rows = _bound(given), exact(given.weight)
        sums = [mpmath.fsum(map(abs, row)) for row in rows]
        scales = [bound / total if total > bound else 1 for total in sums]
        return {
            "weight": [[scale * w for w in row] for scale, row in zip(scales, rows, strict=True)]
        }

    @hookimpl
    def nerfreg_contract(self) -> dict[str, float]:
        """No row of an effective weight sums to more than its bound; the excess is relative to the bound."""
        broken = {}
        for (network, index), layer in self._layers.items():
            bound = float(_bound(layer))
            largest = float(layer.effective()[0].detach().double().abs().sum(-1).max())
            broken[f"rows of {network} {index}"] = (
                max(largest / bound - 1, 0.0) if bound > 0 else largest
            )
        return broken


def _bound(layer: LipschitzLinear) -> Any:
    return mpmath.log1p(mpmath.exp(exact(layer.k)))
