"""Full geometry: every ray hits something.

Source: DiffusioNeRF (Wynn and Turmukhambetov 2023), used by CombiNeRF.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg import Needs, Regularizer, Rendering, hookimpl
from nerfreg.numerics import double, exact, of_rays, one_minus_sum, single
from nerfreg_plugins.references import full_geometry as reference


def full_geometry_loss(
    weights: Float[Tensor, "rays samples"] | Float[Tensor, "rays samples 1"],
) -> Float[Tensor, ""]:
    """Return (1 - sum w)^2, mean over rays, exact also where the sum is almost 1.

    Args:
        weights: `(R, N)` or `(R, N, 1)`.
    """
    weights = of_rays("weights", weights, 2)
    total = single(weights).sum(-1)
    # The compensated sum gives the value and has no gradient; the difference behind it is 0 and
    # carries the gradient, which is -1 for every weight.
    missing = one_minus_sum(double(weights)).to(total.dtype) + (total.detach() - total)
    return missing.square().mean()


def full_geometry_loss_of_thickness(
    tau: Float[Tensor, "rays samples"] | Float[Tensor, "rays samples 1"],
) -> Float[Tensor, ""]:
    """Return (1 - sum w)^2 = exp(-2 sum tau), mean over rays.

    Nothing cancels in this form, so that opaque rays keep a true, tiny gradient in float32.

    Args:
        tau: Optical thickness of the intervals, density times length, `(R, N)` or `(R, N, 1)`.
    """
    tau = of_rays("tau", tau, 2)
    # In float64, because exp turns the absolute rounding error of a large sum into a relative one.
    return torch.exp(-2 * double(tau).sum(-1)).mean().to(single(tau).dtype)


@dataclass
class FullGeometry(Regularizer):
    """Every ray hits something: its weights sum to one (DiffusioNeRF, CombiNeRF).

    The term itself needs no patches. The paper's ablation has a row that draws its rays in patches
    nonetheless, which `patch_size` and `patch_fraction` can reproduce.

    Attributes:
        weight: 1e-4 where the cameras face forward, 1e-3 on orbits; both are CombiNeRF's.
        patch_size: Side of the patches in pixels; 0 for random rays.
        patch_fraction: Share of the training rays that lie in those patches.
    """

    weight: float = 1e-4
    patch_size: int = 0
    patch_fraction: float = 0.0625

    by_layout: ClassVar[dict[str, dict[str, Any]]] = {
        "forward": {"weight": 1e-4},
        "orbit": {"weight": 1e-3},
    }
    cite: ClassVar[str] = "wynn2023diffusionerf"

    @hookimpl
    def nerfreg_needs(self) -> Needs | None:
        if self.patch_size == 0:
            return None
        return Needs(patch_size=self.patch_size, patch_fraction=self.patch_fraction)

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Float[Tensor, ""]]:
        return {"full_geometry": full_geometry_loss_of_thickness(rendering.tau)}

    @property
    def scale_free(self) -> bool:
        """True, since weights have no unit."""
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering):
            return None
        return {"full_geometry": reference.full_geometry_loss_of_thickness(exact(given.tau))}
