"""The rendering integral dT/dt = -sigma T, in a form that stays accurate where it is stiff.

Everything follows from the optical thickness of each interval, tau = sigma * length: the
transmittance up to interval i is exp(-sum of tau before i), and the opacity of the interval is
1 - exp(-tau). Both are used through their logarithms or through expm1, never through 1 - x, which
cancels in thin intervals (Max 1995; Mildenhall et al. 2020, equation 3).
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
"""Samples of less weight get no colour.

Each of them changes the ray's colour by less than 1e-4, a fortieth of a step of 8-bit colour, and
the colour network is twice as expensive as the density network.
"""


@dataclass
class Composite:
    """What compositing makes of the samples of each ray.

    Attributes:
        tau: (R, N) optical thickness of each interval.
        log_transmittance: (R, N) logarithm of the light that reaches each interval.
        weights: (R, N) share of each interval in the ray's colour.
        opacity: (R,) sum of the weights.
        depth: (R,) expected distance; the last edge on empty rays.
        rgb: (R, 3) colour; None where only the density is known.
    """

    tau: Float[Tensor, "rays samples"]
    log_transmittance: Float[Tensor, "rays samples"]
    weights: Float[Tensor, "rays samples"]
    opacity: Float[Tensor, " rays"]
    depth: Float[Tensor, " rays"]
    rgb: Float[Tensor, "rays 3"] | None = None


def integrate(
    sigma: Float[Tensor, "rays samples"], t_edges: Float[Tensor, "rays edges"]
) -> Composite:
    """Return weights, opacity and depth of rays whose density is constant in each interval.

    The depth is the mean of the interval midpoints under the weights. An empty ray, of an opacity
    below `MIN_OPACITY`, has the depth of its far end.

    Args:
        sigma: (R, N) density per unit of t.
        t_edges: (R, N+1) ascending borders of the intervals.

    Returns:
        Everything but the colour.
    """
    sigma, t_edges = single(sigma), single(t_edges)
    tau = sigma * t_edges.diff(dim=1)
    zero = tau.new_zeros(len(tau), 1)
    # The sum of all tau before an interval is accumulated directly: the inclusive sum minus tau
    # would be wrong behind a thick interval.
    log_transmittance = -torch.cat([zero, tau[:, :-1].cumsum(dim=1)], dim=1)
    weights = log_transmittance.exp() * -torch.expm1(-tau)
    # Equal to the sum of the weights, which rounding may carry above 1.
    opacity = -torch.expm1(-tau.sum(dim=1))
    # Detached: which rays are empty is a choice and has no gradient.
    visible = opacity.detach() >= MIN_OPACITY
    midpoints = (t_edges[:, 1:] + t_edges[:, :-1]) / 2
    # Empty rays are divided by 1: the gradient of a branch that `where` discards is multiplied by 0
    # and would be NaN if it were infinite. The sum of the weights, and not the opacity, makes the
    # depth a mean of the midpoints, which lies between them whatever is rounded.
    total = torch.where(visible, weights.sum(dim=1), torch.ones_like(opacity))
    depth = torch.where(visible, (weights * midpoints).sum(dim=1) / total, t_edges[:, -1])
    return Composite(tau, log_transmittance, weights, opacity, depth)


def composite(
    sigma: Float[Tensor, "rays samples"],
    rgb: Float[Tensor, "rays samples 3"],
    t_edges: Float[Tensor, "rays edges"],
    background: Float[Tensor, "rays 3"] | Float[Tensor, " 3"] | None = None,
) -> Composite:
    """Composite densities and colours into one colour per ray.

    Args:
        sigma: (R, N) density per unit of t, constant in each interval.
        rgb: (R, N, 3) colours, constant in each interval.
        t_edges: (R, N+1) ascending borders of the intervals.
        background: (R, 3) or (3,) what shines through where the opacity is below 1; None adds
            nothing.

    Returns:
        All of `Composite`; see `integrate` for the depth.
    """
    result = integrate(sigma, t_edges)
    result.rgb = (result.weights[..., None] * single(rgb)).sum(dim=1)
    if background is not None:
        result.rgb = result.rgb + transmittance(result.tau)[:, None] * single(background)
    return result


def transmittance(tau: Float[Tensor, "rays samples"]) -> Float[Tensor, " rays"]:
    """Return the share of light (R,) that passes a whole ray of optical thicknesses (R, N)."""
    # Not 1 - opacity, which has no correct digit left on an opaque ray.
    return torch.exp(-tau.sum(dim=1))


def assemble(
    rays: Rays,
    t: Float[Tensor, "rays samples"],
    t_edges: Float[Tensor, "rays edges"],
    density: Float[Tensor, "rays samples"],
    color: Callable[[Tensor, Tensor], Float[Tensor, "colored 3"]] | None,
    colored: Bool[Tensor, "rays samples"] | None = None,
) -> Rendering:
    """Make a Rendering of samples; colours are evaluated only where they can be seen.

    This is the one place where a Rendering is made, for training and for checks and benches alike.

    Args:
        rays: R rays.
        t: (R, N) where the field was evaluated.
        t_edges: (R, N+1) ascending borders of the intervals around them.
        density: (R, N) per world unit.
        color: Called with the ray and the sample index of each coloured sample, (K,) each; returns
            their colours (K, 3). None: no sample gets a colour, and that of the rays is NaN.
        colored: (R, N) which samples get a colour; None: those of a weight above `MIN_WEIGHT`.

    Returns:
        The rendering, with its colours on the background of the rays.
    """
    result = integrate(density, t_edges)
    if color is None:
        colored = torch.zeros_like(density, dtype=torch.bool)
        rgb = density.new_full((len(rays), 3), torch.nan)
    else:
        if colored is None:
            colored = result.weights.detach() > MIN_WEIGHT
        ray, sample = colored.nonzero(as_tuple=True)
        colors = color(ray, sample)
        weights = result.weights[ray, sample]
        # Added to the rays by index, so that no (R, N, 3) tensor with mostly zeros is needed.
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
