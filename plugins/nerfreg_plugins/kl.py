"""KL divergence between the ray distributions of adjacent pixels.

Source: the information gain reduction of InfoNeRF (Kim et al. 2022), on weights instead of alphas in CombiNeRF
(Bonotto et al. 2024).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum, auto
from typing import ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg import Needs, Regularizer, Rendering, Step, hookimpl
from nerfreg.numerics import log_alpha

MIN_LOG_Q = math.log(1e-10)
"""Floor of the neighbour's log-probability: one sample may cost at most 23 nats."""


def kl_divergence(
    log_weights: Float[Tensor, "pairs samples"], neighbor_log_weights: Float[Tensor, "pairs samples"]
) -> Float[Tensor, ""]:
    """D(p || q) = sum p log(p / q), p = w / sum w of a ray and q of its neighbour at the same t; mean over pairs.

    log_weights, neighbor_log_weights: (M, N), -inf where a weight is 0. Normalised in log space, so that a common
    factor of all weights of a ray, however small, changes nothing. q is floored at 1e-10. A pair in which either
    ray has no weight at all counts as 0; so does an empty batch.
    """
    log_p, empty = _log_normalized(log_weights)
    log_q, neighbor_empty = _log_normalized(neighbor_log_weights)
    # p log p is 0 where p is: log p leaves the product before it can make 0 times infinity, forward or backward.
    log_ratio = torch.where(log_p > -math.inf, log_p, 0.0) - log_q.clamp_min(MIN_LOG_Q)
    divergence = (log_p.exp() * log_ratio).sum(-1)
    return torch.where(empty | neighbor_empty, 0.0, divergence).sum() / max(len(log_weights), 1)


def _log_normalized(
    log_weights: Float[Tensor, "pairs samples"],
) -> tuple[Float[Tensor, "pairs samples"], Bool[Tensor, " pairs"]]:
    """log(w / sum w), and which rays have no weight at all (those come out uniform)."""
    empty = (log_weights == -math.inf).all(-1)
    filled = torch.where(empty[:, None], 0.0, log_weights)
    return filled - filled.logsumexp(-1, keepdim=True), empty


class Density(StrEnum):
    """What is normalised to a distribution along the ray."""

    weights = auto()
    alphas = auto()


class Neighbors(StrEnum):
    """Where the adjacent pixel comes from."""

    patch = auto()
    extra = auto()


class Direction(StrEnum):
    """forward: D(ray || neighbour). reverse: D(neighbour || ray)."""

    forward = auto()
    reverse = auto()


@dataclass
class KLDivergence(Regularizer):
    """Adjacent rays see alike: KL divergence of their weight distributions (InfoNeRF, CombiNeRF).

    density: `weights` (CombiNeRF) or `alphas` (InfoNeRF). neighbors: `patch` pairs pixels inside patches at no extra
    cost, `extra` renders one more ray per pixel. direction: `forward` is D(ray || neighbour), `reverse` the other
    way round. patch_fraction: share of the training rays in patches (with `neighbors: patch`).
    """

    weight: float = 1e-5
    density: Density = Density.weights
    neighbors: Neighbors = Neighbors.patch
    direction: Direction = Direction.forward
    patch_fraction: float = 0.0625

    cite: ClassVar[str] = """@inproceedings{kim2022infonerf,
  title = {{InfoNeRF}: Ray Entropy Minimization for Few-Shot Neural Volume Rendering},
  author = {Kim, Mijeong and Seo, Seonguk and Han, Bohyung},
  booktitle = {CVPR},
  year = {2022}
}

@inproceedings{bonotto2024combinerf,
  title = {{CombiNeRF}: A Combination of Regularization Techniques for Few-Shot Neural Radiance Field View Synthesis},
  author = {Bonotto, Matteo and Sarrocco, Luigi and Evangelista, Daniele and Imperoli, Marco and Pretto, Alberto},
  booktitle = {3DV},
  year = {2024}
}"""

    @hookimpl
    def nerfreg_needs(self) -> Needs:
        if self.neighbors == Neighbors.extra:
            return Needs(neighbors="extra")
        return Needs(patch_size=2, patch_fraction=self.patch_fraction, neighbors="patch")

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Float[Tensor, ""]]:
        if rendering.rays.neighbors is None:
            return {}
        density = rendering.log_weights if self.density == Density.weights else log_alpha(rendering.tau)
        density = density.masked_fill(~rendering.visible[:, None], -math.inf)
        ray, neighbor = density[rendering.rays.neighbors[:, 0]], density[rendering.rays.neighbors[:, 1]]
        if self.direction == Direction.reverse:
            ray, neighbor = neighbor, ray
        return {"kl": kl_divergence(ray, neighbor)}
