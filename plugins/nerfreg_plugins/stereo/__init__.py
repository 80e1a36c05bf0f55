"""Depth that the photographs agree on, without any learned prior.

Source: DS-NeRF (Deng et al. 2022), which supervises the weights along a ray by a depth. Dense
stereo instead of sparse points, intervals instead of points, and the doubt are our own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import mpmath
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg import Photographs, Regularizer, Rendering, hookimpl
from nerfreg.errors import require_range
from nerfreg.numerics import double, exact, of_rays, one_minus_sum, ray_samples, single
from nerfreg_plugins.references import stereo as reference
from nerfreg_plugins.stereo.search import agreed_depth


def stereo_loss(
    weights: Float[Tensor, "rays samples"] | Float[Tensor, "rays samples 1"],
    t_edges: Float[Tensor, "rays edges"] | Float[Tensor, "rays edges 1"],
    known_depth: Float[Tensor, "rays 2"],
    doubt: float = 0.1,
    tau: Float[Tensor, "rays samples"] | Float[Tensor, "rays samples 1"] | None = None,
) -> Float[Tensor, ""]:
    """Return log((1 + doubt) / (m + doubt)), m the weight at the known depth; mean over rays.

    m sums the weights of the intervals that reach into the known one, and 1 / (1 + x^2) of the
    weight of an interval that is x times half the extent of the known one away from it. Rays of
    which nothing is known, or no interval of which reaches there, give 0.

    Args:
        weights: `(R, N)` or `(R, N, 1)`.
        t_edges: Interval borders, `(R, N+1)` or `(R, N+1, 1)`.
        known_depth: Between which distances a surface is known to be, `(R, 2)`; NaN where unknown.
        doubt: How likely it is that what is known is wrong. The more doubt, the less it costs to be
            elsewhere: the gradient of a ray that misses the surface is -1 / doubt.
        tau: Optical thickness of the intervals, density times length, `(R, N)` or `(R, N, 1)`,
            which tells to all digits what passes an opaque ray; None: it is 1 - sum w.
    """
    weights, t_edges = ray_samples(weights, t_edges)
    weights, edges, known = single(weights), double(t_edges), double(known_depth)
    first, last = known[:, :, None].unbind(1)
    # Comparisons with NaN are false, so that a ray of unknown depth has no interval that is close.
    close = (edges[:, 1:] >= first) & (edges[:, :-1] <= last)
    # The tails of 1 / (1 + x^2) still pull from outside of what is known, where an interval with
    # hard ends has no gradient.
    off = torch.maximum(first - edges[:, 1:], edges[:, :-1] - last) / ((last - first) / 2)
    # Infinity stands for "not there at all", which both quotients below take as it is meant.
    squared = (
        torch.where(close, 0.0, off.square())
        .nan_to_num(nan=torch.inf, posinf=torch.inf)
        .to(weights.dtype)
    )
    passed = _passed(weights, tau)
    # What the rest of the ray and the background get is 1 - m, added up instead of subtracted: it
    # keeps its digits where m is almost 1.
    there = (weights / (1 + squared)).sum(-1)
    elsewhere = (weights / (1 + 1 / squared)).sum(-1) + passed
    missed = torch.log1p(elsewhere / (there + doubt))
    return torch.where(close.any(-1), missed, 0.0).sum() / max(len(weights), 1)


def _passed(weights: Float[Tensor, "rays samples"], tau: Tensor | None) -> Float[Tensor, " rays"]:
    """Return the light that passes all intervals of each ray."""
    if tau is not None:
        tau = of_rays("tau", tau, 2, weights.shape[1])
        return torch.exp(-double(tau).sum(-1)).to(weights.dtype)
    total = weights.sum(-1)
    # The compensated sum gives the value and has no gradient; the difference behind it is 0 and
    # carries the gradient, which is -1 for every weight.
    missing = one_minus_sum(double(weights)).clamp_min(0).to(weights.dtype)
    return missing + (total.detach() - total)


@dataclass
class Stereo(Regularizer):
    """Weights lie where the photographs agree that something is, by PatchMatch stereo.

    The search runs once, before the first step.

    Attributes:
        weight: Our own, from held-out views of fern and chair.
        doubt: How likely it is that a depth is wrong.
        width: Pixels to which the longer side of the photographs is reduced, about.
        window: Side of the windows that are compared, in reduced pixels; at least 5.
        sources: With how many of the nearest views each is compared.
        tolerance: Pixels to which the views have to agree, and half the extent of what is known.
    """

    weight: float = 0.01
    doubt: float = 0.1
    width: int = 512
    window: int = 9
    sources: int = 4
    tolerance: float = 1.0

    cite: ClassVar[str] = "deng2022dsnerf"

    def __post_init__(self) -> None:
        # A window of fewer than 5 pixels a side has nothing but its middle to compare, since every
        # second pixel counts.
        require_range("reg.stereo", self, doubt=(1e-6, 1e6), width=(1, math.inf), window=(5, 99))
        require_range("reg.stereo", self, sources=(1, math.inf), tolerance=(1e-3, 1e3))

    @hookimpl
    def nerfreg_known_depth(
        self, photographs: Photographs
    ) -> Float[Tensor, "views height width 2"]:
        return agreed_depth(photographs, self.width, self.window, self.sources, self.tolerance)

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Float[Tensor, ""]]:
        known = rendering.rays.known_depth
        if known is None:
            return {}
        # Rays without a photograph come last, and nothing is known of them.
        weights, tau, edges = (
            x[: len(known)] for x in (rendering.weights, rendering.tau, rendering.t_edges)
        )
        return {"stereo": stereo_loss(weights, edges, known, self.doubt, tau)}

    @property
    def scale_free(self) -> bool:
        """True, since distances count relative to the extent of what is known."""
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering) or given.rays.known_depth is None:
            return None
        known, doubt = given.rays.known_depth, mpmath.mpf(self.doubt)
        weights, tau, edges = (
            exact(x[: len(known)]) for x in (given.weights, given.tau, given.t_edges)
        )
        return {"stereo": reference.stereo_loss(weights, edges, exact(known), doubt, tau)}
