"""The losses in the forms that are in use elsewhere, to be compared with; nothing but the bench calls them.

Each takes a rendering and returns what the plugin of that name returns: the mean over rays, or over pairs of rays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.hooks import Rendering

EPSILON = 1e-10
"""What public programs add before they divide or take a logarithm."""
ENTROPY_THRESHOLD = 0.1
"""Rays whose alphas sum to less do not count, as in the plugin."""


@dataclass(frozen=True)
class Rival:
    """name: in tables and plots. most_samples: beyond which it takes too much memory."""

    name: str
    loss: Callable[[Rendering], Float[Tensor, ""]]
    most_samples: int | None = None


def distortion_by_pairs(rendering: Rendering) -> Float[Tensor, ""]:
    """The double sum as it is defined, O(N^2) in time and memory."""
    weights, middle = rendering.weights, _midpoints(rendering)
    apart = (middle[:, :, None] - middle[:, None, :]).abs()
    pairs = (weights[:, :, None] * weights[:, None, :] * apart).sum(dim=(1, 2))
    return _distortion(rendering, pairs)


def distortion_by_prefix_sums(rendering: Rendering) -> Float[Tensor, ""]:
    """2 sum_i w_i (m_i sum_{j<i} w_j - sum_{j<i} w_j m_j): O(N), a small difference of large numbers."""
    weights, middle = rendering.weights, _midpoints(rendering)
    moments = weights * middle
    before = weights.cumsum(dim=1) - weights
    moments_before = moments.cumsum(dim=1) - moments
    pairs = 2 * (weights * (middle * before - moments_before)).sum(dim=1)
    return _distortion(rendering, pairs)


def _distortion(rendering: Rendering, pairs: Float[Tensor, " rays"]) -> Float[Tensor, ""]:
    own = (rendering.weights.square() * rendering.t_edges.diff(dim=1)).sum(dim=1) / 3
    return ((pairs + own) / rendering.depth).mean()


def _midpoints(rendering: Rendering) -> Float[Tensor, "rays samples"]:
    return (rendering.t_edges[:, 1:] + rendering.t_edges[:, :-1]) / 2


def kl_with_epsilon(rendering: Rendering) -> Float[Tensor, ""]:
    """sum p log((p + 1e-10) / (q + 1e-10)) from weights, not from their logarithms."""
    assert rendering.rays.neighbors is not None
    share = rendering.weights / (rendering.weights.sum(dim=1, keepdim=True) + EPSILON)
    p, q = share[rendering.rays.neighbors[:, 0]], share[rendering.rays.neighbors[:, 1]]
    return (p * ((p + EPSILON) / (q + EPSILON)).log()).sum(dim=1).mean()


def entropy_with_epsilon(rendering: Rendering) -> Float[Tensor, ""]:
    """-sum q log(q + 1e-10)."""
    return _entropy(rendering.alphas, EPSILON)


def entropy_of_rounded_alphas(rendering: Rendering) -> Float[Tensor, ""]:
    """The same, with alpha = 1 - exp(-tau) besides as it stands, which cancels where tau is small."""
    return _entropy(1 - torch.exp(-rendering.tau), EPSILON)


def _entropy(alphas: Float[Tensor, "rays samples"], epsilon: float) -> Float[Tensor, ""]:
    total = alphas.sum(dim=1)
    q = alphas / (total[:, None] + epsilon)
    return (-(q * (q + epsilon).log()).sum(dim=1) * (total > ENTROPY_THRESHOLD)).mean()


def full_geometry_from_weights(rendering: Rendering) -> Float[Tensor, ""]:
    """(1 - sum w)^2 as it stands, which cancels on opaque rays."""
    return (1 - rendering.weights.sum(dim=1)).square().mean()


ALL_PAIRS, PREFIX_SUMS, WITH_EPSILON = "all pairs", "prefix sums", "+ 1e-10"
RIVALS: dict[str, tuple[Rival, ...]] = {
    "distortion": (
        Rival(ALL_PAIRS, distortion_by_pairs, 512),
        Rival(PREFIX_SUMS, distortion_by_prefix_sums),
    ),
    "kl": (Rival(WITH_EPSILON, kl_with_epsilon),),
    "entropy": (
        Rival(WITH_EPSILON, entropy_with_epsilon),
        Rival("1 - exp(-tau)", entropy_of_rounded_alphas),
    ),
    "full_geometry": (Rival("1 - sum w", full_geometry_from_weights),),
}
"""By the name of the plugin that they are compared with."""
