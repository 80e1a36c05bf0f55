"""Occlusion: nothing floats before the camera. Source: FreeNeRF (Yang et al. 2023)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum, auto
from itertools import pairwise
from typing import Any, ClassVar

import mpmath
from jaxtyping import Float
from torch import Tensor

from nerfreg import Regularizer, Rendering, hookimpl
from nerfreg.numerics import double, exact, single


def occlusion(
    weights: Float[Tensor, "rays samples"],
    t_edges: Float[Tensor, "rays edges"],
    near: Float[Tensor, " rays"],
    far: Float[Tensor, " rays"],
    fraction: float,
) -> Float[Tensor, ""]:
    """Mean of the weights (or densities) over the samples in the first `fraction` of [near, far]; mean over rays.

    weights: (R, N). t_edges: (R, N+1). near, far: (R,). A sample lies there if the midpoint of its interval does. A
    ray without such a sample, and a fraction of 0, give 0.
    """
    weights, edges, near, far = single(weights), double(t_edges), double(near), double(far)
    midpoints = (edges[:, 1:] + edges[:, :-1]) / 2
    close = midpoints < (near + fraction * (far - near))[:, None]
    return ((weights * close).sum(-1) / close.sum(-1).clamp_min(1)).mean()


class Quantity(StrEnum):
    """What must not lie before the camera."""

    weights = auto()
    density = auto()


@dataclass
class Occlusion(Regularizer):
    """Nothing floats before the camera: weights near it are penalised (FreeNeRF).

    fraction: how much of each ray, from near on, is kept free. quantity: `weights`, or `density` (as in the source;
    per world unit, so its weight depends on the size of the scene).
    """

    # The weight is FreeNeRF's, and its 10 of 128 samples are about a tenth of the ray.
    weight: float = 0.01
    fraction: float = 0.1
    quantity: Quantity = Quantity.weights

    cite: ClassVar[str] = "yang2023freenerf"

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Float[Tensor, ""]]:
        return {"occlusion": occlusion(*self._inputs(rendering), self.fraction)}

    def _inputs(self, rendering: Rendering) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        penalised = rendering.weights if self.quantity == Quantity.weights else rendering.density
        return penalised, rendering.t_edges, rendering.rays.near, rendering.rays.far

    @property
    def scale_free(self) -> bool:
        return self.quantity == Quantity.weights

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering):
            return None
        weights, t_edges, near, far = map(exact, self._inputs(given))
        means = [
            _reference(*ray, self.fraction) for ray in zip(weights, t_edges, near, far, strict=True)
        ]
        return {"occlusion": mpmath.fsum(means) / len(means)}


def _reference(
    penalised: list[Any], t_edges: list[Any], near: Any, far: Any, fraction: float
) -> Any:
    """The definition, literally."""
    border = near + mpmath.mpf(fraction) * (far - near)
    middles = [(low + high) / 2 for low, high in pairwise(t_edges)]
    close = [value for value, middle in zip(penalised, middles, strict=True) if middle < border]
    return mpmath.fsum(close) / max(len(close), 1)
