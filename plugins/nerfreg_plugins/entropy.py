"""Ray entropy. Source: InfoNeRF (Kim et al. 2022)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg import Needs, Regularizer, Rendering, hookimpl
from nerfreg.numerics import MIN_OPACITY


def ray_entropy(alphas: Float[Tensor, "rays samples"], threshold: float) -> Float[Tensor, ""]:
    """H = -sum q log q, q = alpha / sum alpha, of the rays with sum alpha > threshold; the others count as 0.

    alphas: (R, N). Mean over all rays. 0 log 0 = 0, and such a sample gets no gradient. A threshold below
    `MIN_OPACITY` is raised to it: fainter rays are empty.
    """
    total = alphas.sum(-1, keepdim=True)
    counted = total.detach() > max(threshold, MIN_OPACITY)
    q = alphas / torch.where(counted, total, 1.0)
    log_q = torch.where(q > 0, q, 1.0).log()
    return torch.where(counted, -q * log_q, 0.0).sum(-1).mean()


@dataclass
class RayEntropy(Regularizer):
    """Rays meet matter in few places: low entropy of alpha, on seen and unseen views (InfoNeRF).

    threshold: rays whose alphas sum to less are left out. unseen_rays: rays from poses between the training views,
    as a share of the training rays.
    """

    # InfoNeRF's weight and threshold; CombiNeRF names none. Its unseen rays are as many as its training rays, which
    # doubles the cost of a step: a quarter is the same compromise as for patches.
    weight: float = 1e-3
    threshold: float = 0.1
    unseen_rays: float = 0.25

    cite: ClassVar[str] = """@inproceedings{kim2022infonerf,
  title = {{InfoNeRF}: Ray Entropy Minimization for Few-Shot Neural Volume Rendering},
  author = {Kim, Mijeong and Seo, Seonguk and Han, Bohyung},
  booktitle = {CVPR},
  year = {2022}
}"""

    @hookimpl
    def nerfreg_needs(self) -> Needs:
        return Needs(unseen_rays=self.unseen_rays)

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Float[Tensor, ""]]:
        return {"entropy": ray_entropy(rendering.alphas, self.threshold)}
