"""The losses in the forms that are in use elsewhere, to compare with; only the bench calls them.

Each takes a rendering and returns what the plugin of that name returns: the mean over rays, or
over pairs of rays.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.hooks import Rendering

EPSILON = 1e-10
"""What public programs add before they divide or take a logarithm."""
ENTROPY_THRESHOLD = 0.1
"""Rays whose alphas sum to less do not count, as in the plugin."""


def distortion_by_pairs(rendering: Rendering) -> Float[Tensor, ""]:
    """Return the double sum as it is defined, O(N^2) in time and memory."""
    weights, middle = rendering.weights, _midpoints(rendering)
    apart = (middle[:, :, None] - middle[:, None, :]).abs()
    pairs = (weights[:, :, None] * weights[:, None, :] * apart).sum(dim=(1, 2))
    return _distortion(rendering, pairs)


def distortion_by_prefix_sums(rendering: Rendering) -> Float[Tensor, ""]:
    """Return 2 sum_i w_i (m_i sum_{j<i} w_j - sum_{j<i} w_j m_j): O(N), but cancels."""
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
    """Return sum p log((p + 1e-10) / (q + 1e-10)) from weights, not from their logarithms."""
    assert rendering.rays.neighbors is not None
    share = rendering.weights / (rendering.weights.sum(dim=1, keepdim=True) + EPSILON)
    p, q = share[rendering.rays.neighbors[:, 0]], share[rendering.rays.neighbors[:, 1]]
    return (p * ((p + EPSILON) / (q + EPSILON)).log()).sum(dim=1).mean()


def entropy_with_epsilon(rendering: Rendering) -> Float[Tensor, ""]:
    """Return -sum q log(q + 1e-10)."""
    return _entropy(rendering.alphas)


def entropy_of_rounded_alphas(rendering: Rendering) -> Float[Tensor, ""]:
    """Return the same with alpha = 1 - exp(-tau) as it stands, which cancels where tau is small."""
    return _entropy(1 - torch.exp(-rendering.tau))


def _entropy(alphas: Float[Tensor, "rays samples"]) -> Float[Tensor, ""]:
    total = alphas.sum(dim=1)
    q = alphas / (total[:, None] + EPSILON)
    return (-(q * (q + EPSILON).log()).sum(dim=1) * (total > ENTROPY_THRESHOLD)).mean()


def full_geometry_from_weights(rendering: Rendering) -> Float[Tensor, ""]:
    """Return (1 - sum w)^2 as it stands, which cancels on opaque rays."""
    return (1 - rendering.weights.sum(dim=1)).square().mean()


RIVALS: dict[str, dict[str, Callable[[Rendering], Float[Tensor, ""]]]] = {
    "distortion": {"all pairs": distortion_by_pairs, "prefix sums": distortion_by_prefix_sums},
    "kl": {"+ 1e-10": kl_with_epsilon},
    "entropy": {"+ 1e-10": entropy_with_epsilon, "1 - exp(-tau)": entropy_of_rounded_alphas},
    "full_geometry": {"1 - sum w": full_geometry_from_weights},
}
"""Other forms by name, by the name of the plugin that they are compared with."""
MOST_SAMPLES = {"all pairs": 512}
"""Beyond these samples a form takes too much memory."""
