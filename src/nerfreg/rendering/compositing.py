"""The rendering integral dT/dt = -sigma T, in a form that does not lose digits where it is stiff.

Everything follows from the optical thickness of each interval, tau = sigma * length: the transmittance that reaches
interval i is exp(-sum of tau before i), the interval's opacity is 1 - exp(-tau), and both are used through their
logarithm or through expm1, never through 1 - x.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.numerics import MIN_OPACITY, single


@dataclass
class Composite:
    """What becomes of the samples of each ray; see `nerfreg.Rendering` for the meaning of each part."""

    tau: Float[Tensor, "rays samples"]
    log_transmittance: Float[Tensor, "rays samples"]
    weights: Float[Tensor, "rays samples"]
    opacity: Float[Tensor, " rays"]
    depth: Float[Tensor, " rays"]
    rgb: Float[Tensor, "rays 3"] | None = None


def integrate(
    sigma: Float[Tensor, "rays samples"], t_edges: Float[Tensor, "rays edges"]
) -> Composite:
    """Weights, opacity and depth of rays (R, N+1 edges) whose density sigma (R, N) is constant in each interval.

    Depth is the mean interval midpoint under the weights; an empty ray (opacity < 1e-4) has the depth of its far end.
    """
    sigma, t_edges = single(sigma), single(t_edges)
    tau = sigma * t_edges.diff(dim=1)
    zero = tau.new_zeros(len(tau), 1)
    log_transmittance = -torch.cat([zero, tau[:, :-1].cumsum(dim=1)], dim=1)
    weights = log_transmittance.exp() * -torch.expm1(-tau)
    opacity = -torch.expm1(-tau.sum(dim=1))
    visible = opacity.detach() >= MIN_OPACITY
    midpoints = (t_edges[:, 1:] + t_edges[:, :-1]) / 2
    total = torch.where(visible, weights.sum(dim=1), torch.ones_like(opacity))
    depth = torch.where(visible, (weights * midpoints).sum(dim=1) / total, t_edges[:, -1])
    return Composite(tau, log_transmittance, weights, opacity, depth)


def composite(
    sigma: Float[Tensor, "rays samples"],
    rgb: Float[Tensor, "rays samples 3"],
    t_edges: Float[Tensor, "rays edges"],
    background: Float[Tensor, "rays 3"] | Float[Tensor, " 3"] | None = None,
) -> Composite:
    """Render rays: density (R, N) per unit length, colour (R, N, 3) and edges (R, N+1) to one colour each, (R, 3).

    background: what shines through where opacity is below 1; None adds nothing. See `integrate` for the rest.
    """
    result = integrate(sigma, t_edges)
    result.rgb = (result.weights[..., None] * single(rgb)).sum(dim=1)
    if background is not None:
        result.rgb = result.rgb + transmittance(result.tau)[:, None] * single(background)
    return result


def transmittance(tau: Float[Tensor, "rays samples"]) -> Float[Tensor, " rays"]:
    """The share of light that passes a whole ray."""
    return torch.exp(-tau.sum(dim=1))
