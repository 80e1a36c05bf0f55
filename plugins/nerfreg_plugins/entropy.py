"""Ray entropy. Source: InfoNeRF (Kim et al. 2022)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import mpmath
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg import Needs, Regularizer, Rendering, hookimpl
from nerfreg.numerics import MIN_OPACITY, exact, single


def ray_entropy(alphas: Float[Tensor, "rays samples"], threshold: float) -> Float[Tensor, ""]:
    """H = -sum q log q, q = alpha / sum alpha, of the rays with sum alpha > threshold; the others count as 0.

    alphas: (R, N). Mean over all rays. 0 log 0 = 0; the gradient there, infinite in truth, is that of the smallest
    normal number. A threshold below `MIN_OPACITY` is raised to it: fainter rays are empty.
    """
    alphas = single(alphas)
    total = alphas.sum(-1, keepdim=True)
    counted = total.detach() > max(threshold, MIN_OPACITY)
    q = alphas / torch.where(counted, total, 1.0)
    # As sum dq = 0, so is sum q dlog(q): the logarithm needs no gradient.
    return torch.where(counted, q * _surprise(alphas.detach(), q.detach()), 0.0).sum(-1).mean()


def _surprise(
    alphas: Float[Tensor, "rays samples"], q: Float[Tensor, "rays samples"]
) -> Float[Tensor, "rays samples"]:
    """-log q, also where one sample has nearly everything: then from the little that the others have."""
    largest = alphas.argmax(-1, keepdim=True)
    rest = alphas.scatter(-1, largest, 0.0).sum(-1, keepdim=True)
    of_largest = torch.log1p(
        rest / alphas.gather(-1, largest).clamp_min(MIN_OPACITY / alphas.shape[-1])
    )
    plain = -q.clamp_min(torch.finfo(q.dtype).tiny).log()
    return torch.where(q > 0.5, of_largest, plain)


@dataclass
class RayEntropy(Regularizer):
    """Rays meet matter in few places: low entropy of alpha, on seen and unseen views (InfoNeRF).

    threshold: rays whose alphas sum to less are left out. unseen_rays: rays from poses between the training views,
    as a share of a step's rays, whose place they take.
    """

    # InfoNeRF's weight and threshold; CombiNeRF names none. Its unseen rays are as many as its training rays (0.5
    # here); they take the place of training rays, and a quarter leaves most of those.
    weight: float = 1e-3
    threshold: float = 0.1
    unseen_rays: float = 0.25

    cite: ClassVar[str] = "kim2022infonerf"

    @hookimpl
    def nerfreg_needs(self) -> Needs:
        return Needs(unseen_rays=self.unseen_rays)

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Float[Tensor, ""]]:
        return {"entropy": ray_entropy(rendering.alphas, self.threshold)}

    @property
    def scale_free(self) -> bool:
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering):
            return None
        entropies = [
            _reference(alphas, max(self.threshold, MIN_OPACITY)) for alphas in exact(given.alphas)
        ]
        return {"entropy": mpmath.fsum(entropies) / len(entropies)}


def _reference(alphas: list[Any], threshold: float) -> Any:
    """The definition, literally."""
    total = mpmath.fsum(alphas)
    if total <= threshold:
        return 0
    return -mpmath.fsum(a / total * mpmath.log(a / total) for a in alphas if a > 0)
