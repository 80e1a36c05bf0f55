"""Full geometry: every ray hits something. Source: DiffusioNeRF (Wynn and Turmukhambetov 2023), used by CombiNeRF."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import mpmath
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg import Needs, Regularizer, Rendering, hookimpl
from nerfreg.numerics import double, exact, one_minus_sum, single


def full_geometry(weights: Float[Tensor, "rays samples"]) -> Float[Tensor, ""]:
    """(1 - sum w)^2, mean over rays. weights: (R, N). Exact also where the sum is almost 1."""
    total = single(weights).sum(-1)
    missing = one_minus_sum(double(weights)).to(total.dtype) + (total.detach() - total)
    return missing.square().mean()


def full_geometry_of_thickness(tau: Float[Tensor, "rays samples"]) -> Float[Tensor, ""]:
    """The same from optical thickness (R, N): exp(-2 sum tau), which does not cancel on opaque rays."""
    return torch.exp(-2 * double(tau).sum(-1)).mean().to(single(tau).dtype)


@dataclass
class FullGeometry(Regularizer):
    """Every ray ends on something: its weights sum to one (DiffusioNeRF, CombiNeRF).

    patch_size, patch_fraction: draw this share of the training rays as square patches, which the term itself does
    not need; the paper's ablation has a row of its own for it (0: random rays).
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
        return (
            Needs(patch_size=self.patch_size, patch_fraction=self.patch_fraction)
            if self.patch_size
            else None
        )

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Float[Tensor, ""]]:
        return {"full_geometry": full_geometry_of_thickness(rendering.tau)}

    @property
    def scale_free(self) -> bool:
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering):
            return None
        passed = [mpmath.exp(-2 * mpmath.fsum(tau)) for tau in exact(given.tau)]
        return {"full_geometry": mpmath.fsum(passed) / len(passed)}
