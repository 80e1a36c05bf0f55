"""The rendering integral dT/dt = -sigma T, in a form that does not lose digits where it is stiff.

Everything follows from the optical thickness of each interval, tau = sigma * length: the transmittance that reaches
interval i is exp(-sum of tau before i), the interval's opacity is 1 - exp(-tau), and both are used through their
logarithm or through expm1, never through 1 - x.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg.hooks import Rays, Rendering
from nerfreg.numerics import MIN_OPACITY, single

MIN_WEIGHT = 1e-4
"""Samples below this weight have no visible colour; the colour network does not run for them."""


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


def assemble(
    rays: Rays,
    t: Float[Tensor, "rays samples"],
    t_edges: Float[Tensor, "rays edges"],
    density: Float[Tensor, "rays samples"],
    color: Callable[[Tensor, Tensor], Float[Tensor, "colored 3"]],
    colored: Bool[Tensor, "rays samples"] | None = None,
) -> Rendering:
    """Make a Rendering of samples; colours are evaluated only where they can be seen.

    This is the one place where a Rendering is made, for training and for checks and benches alike.

    Args:
        rays: R rays.
        t: (R, N) where the field was evaluated.
        t_edges: (R, N+1) borders of the intervals around them, ascending.
        density: (R, N) per world unit.
        color: Called with the ray and the sample index of each coloured sample, (K,) each; returns
            their colours (K, 3).
        colored: (R, N) which samples get a colour; None: those of a weight above `MIN_WEIGHT`.
    """
    result = integrate(density, t_edges)
    if colored is None:
        colored = result.weights.detach() > MIN_WEIGHT
    ray, sample = colored.nonzero(as_tuple=True)
    colors = color(ray, sample)
    weights = result.weights[ray, sample]
    rgb = colors.new_zeros(len(rays), 3).index_add(0, ray, weights[:, None] * colors)
    if rays.background is not None:
        rgb = rgb + transmittance(result.tau)[:, None] * single(rays.background)
    return Rendering(
        rays=rays,
        t_edges=t_edges,
        t=t,
        density=density,
        tau=result.tau,
        log_transmittance=result.log_transmittance,
        weights=result.weights,
        opacity=result.opacity,
        depth=result.depth,
        rgb=rgb,
        colored=colored,
    )
