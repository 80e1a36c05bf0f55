"""Occlusion: nothing floats in front of the camera. Source: FreeNeRF (Yang et al. 2023)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum, auto
from typing import Any, ClassVar

import mpmath
from jaxtyping import Float
from torch import Tensor

from nerfreg import Regularizer, Rendering, hookimpl
from nerfreg.numerics import double, exact, of_rays, ray_samples, single
from nerfreg_plugins.references import occlusion as reference


def occlusion_loss(
    weights: Float[Tensor, "rays samples"] | Float[Tensor, "rays samples 1"],
    t_edges: Float[Tensor, "rays edges"] | Float[Tensor, "rays edges 1"],
    near: Float[Tensor, " rays"] | Float[Tensor, "rays 1"] | None = None,
    far: Float[Tensor, " rays"] | Float[Tensor, "rays 1"] | None = None,
    fraction: float = 0.1,
) -> Float[Tensor, ""]:
    """Return the mean over the samples in the first `fraction` of [near, far], mean over rays.

    A sample lies there if the midpoint of its interval does. A ray without such a sample, and a
    fraction of 0, give 0.

    Args:
        weights: What is penalised, weights or densities, `(R, N)` or `(R, N, 1)`.
        t_edges: Interval borders, `(R, N+1)` or `(R, N+1, 1)`.
        near: Where each ray begins, `(R,)` or `(R, 1)`; None: at the first border.
        far: Where it ends, likewise; None: at the last border.
        fraction: Share of the ray that should be empty.
    """
    # Distances in float64, so that far from the origin rounding does not decide which midpoints
    # lie before the border; the values themselves need no more than their own precision.
    weights, t_edges = ray_samples(weights, t_edges)
    weights, edges = single(weights), double(t_edges)
    near = edges[:, 0] if near is None else double(of_rays("near", near, 1))
    far = edges[:, -1] if far is None else double(of_rays("far", far, 1))
    midpoints = (edges[:, 1:] + edges[:, :-1]) / 2
    close = midpoints < (near + fraction * (far - near))[:, None]
    return ((weights * close).sum(-1) / close.sum(-1).clamp_min(1)).mean()


class Quantity(StrEnum):
    """What must not lie in front of the camera."""

    weights = auto()
    density = auto()


@dataclass
class Occlusion(Regularizer):
    """Nothing floats in front of the camera: weights near it are penalised (FreeNeRF).

    Attributes:
        weight: FreeNeRF's.
        fraction: How much of each ray, from near on, should be empty. FreeNeRF has 10 of 128
            samples, about a tenth.
        quantity: `weights`, or `density` as in FreeNeRF. Density is per world unit, so that the
            fitting `weight` depends on the size of the scene.
    """

    weight: float = 0.01
    fraction: float = 0.1
    quantity: Quantity = Quantity.weights

    cite: ClassVar[str] = "yang2023freenerf"

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Float[Tensor, ""]]:
        return {"occlusion": occlusion_loss(*self._inputs(rendering), self.fraction)}

    def _inputs(self, rendering: Rendering) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        penalised = rendering.weights if self.quantity == Quantity.weights else rendering.density
        return penalised, rendering.t_edges, rendering.rays.near, rendering.rays.far

    @property
    def scale_free(self) -> bool:
        """Whether weights are penalised, which have no unit."""
        return self.quantity == Quantity.weights

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering):
            return None
        weights, t_edges, near, far = map(exact, self._inputs(given))
        fraction = mpmath.mpf(self.fraction)
        return {"occlusion": reference.occlusion_loss(weights, t_edges, near, far, fraction)}
