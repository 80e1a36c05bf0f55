"""Ray entropy. Source: InfoNeRF (Kim et al. 2022)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg import Needs, Regularizer, Rendering, hookimpl
from nerfreg.numerics import MIN_OPACITY, exact, of_rays, single
from nerfreg_plugins.references import entropy as reference


def entropy_loss(
    alphas: Float[Tensor, "rays samples"] | Float[Tensor, "rays samples 1"], threshold: float = 0.1
) -> Float[Tensor, ""]:
    """Return H = -sum q log q with q = alpha / sum alpha, mean over all rays.

    0 log 0 is 0. The gradient there is infinite in truth; the one returned is that of the smallest
    normal number.

    Args:
        alphas: Opacity of each interval, 1 - exp(-density times length), `(R, N)` or `(R, N, 1)`.
        threshold: Rays whose alphas sum to no more than this count as 0. A threshold below
            `MIN_OPACITY` is raised to it: fainter rays are empty.
    """
    alphas = single(of_rays("alphas", alphas, 2))
    total = alphas.sum(-1, keepdim=True)
    # Detached, because which rays count is a decision and not a quantity to be trained.
    counted = total.detach() > max(threshold, MIN_OPACITY)
    q = alphas / torch.where(counted, total, 1.0)
    # As sum dq = 0, so is sum q dlog(q): the logarithm needs no gradient.
    return torch.where(counted, q * _surprise(alphas.detach(), q.detach()), 0.0).sum(-1).mean()


def _surprise(
    alphas: Float[Tensor, "rays samples"], q: Float[Tensor, "rays samples"]
) -> Float[Tensor, "rays samples"]:
    """Return -log q, also where one sample has nearly everything."""
    largest = alphas.argmax(-1, keepdim=True)
    rest = alphas.scatter(-1, largest, 0.0).sum(-1, keepdim=True)
    # Where q rounds to 1, -log q would round to 0. It is log1p of what the other samples have,
    # relative to what this one has, and both of these are known to all digits. The clamp changes
    # no ray that counts, whose largest alpha is at least the mean; it keeps empty rays finite.
    of_largest = torch.log1p(
        rest / alphas.gather(-1, largest).clamp_min(MIN_OPACITY / alphas.shape[-1])
    )
    plain = -q.clamp_min(torch.finfo(q.dtype).tiny).log()
    # Only the largest sample can have more than half.
    return torch.where(q > 0.5, of_largest, plain)


@dataclass
class RayEntropy(Regularizer):
    """Rays meet matter in few places: low entropy of alpha, on seen and unseen views (InfoNeRF).

    Attributes:
        weight: InfoNeRF's; CombiNeRF names none.
        threshold: Rays whose alphas sum to less are left out; InfoNeRF's.
        unseen_rays: Rays from poses between the training views, as a share of a step's rays, whose
            place they take.
    """

    # InfoNeRF renders as many unseen rays as training rays, which would be 0.5 here. Since they
    # take the place of training rays, a quarter leaves most of those.
    weight: float = 1e-3
    threshold: float = 0.1
    unseen_rays: float = 0.25

    cite: ClassVar[str] = "kim2022infonerf"

    @hookimpl
    def nerfreg_needs(self) -> Needs:
        return Needs(unseen_rays=self.unseen_rays)

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Float[Tensor, ""]]:
        return {"entropy": entropy_loss(rendering.alphas, self.threshold)}

    @property
    def scale_free(self) -> bool:
        """True, since alphas have no unit."""
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering):
            return None
        threshold = max(self.threshold, MIN_OPACITY)
        return {"entropy": reference.entropy_loss(exact(given.alphas), threshold)}
