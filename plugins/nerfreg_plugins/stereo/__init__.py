"""Depth that the photographs agree on, without any learned prior. Source: depth supervision of the weights along a ray,
DS-NeRF (Deng et al. 2022); dense stereo instead of sparse points, and doubt, are ours."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import mpmath
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg import Photographs, Regularizer, Rendering, hookimpl
from nerfreg.errors import require_range
from nerfreg.numerics import double, exact, single
from nerfreg_plugins.stereo.search import agreed_depth


def missed_depth(
    weights: Float[Tensor, "rays samples"],
    tau: Float[Tensor, "rays samples"],
    t_edges: Float[Tensor, "rays edges"],
    known_depth: Float[Tensor, "rays 2"],
    doubt: float,
) -> Float[Tensor, ""]:
    """log((1 + doubt) / (m + doubt)), m the weights where something is known to be; mean over rays.

    weights, tau: (R, N), tau the optical thickness. t_edges: (R, N+1). known_depth: (R, 2), between which distances. m
    sums the weights of the intervals that reach into them, and 1 / (1 + x^2) of the weight of one that is x times half
    their extent away. Rays of which nothing is known (NaN), or no interval of which reaches there, give 0. With more
    doubt it costs less to be elsewhere: what is known may be wrong.
    """
    weights, edges, (first, last) = (
        single(weights),
        double(t_edges),
        double(known_depth)[:, :, None].unbind(1),
    )
    close = (edges[:, 1:] >= first) & (edges[:, :-1] <= last)
    off = torch.maximum(first - edges[:, 1:], edges[:, :-1] - last) / ((last - first) / 2)
    squared = (
        torch.where(close, 0.0, off.square())
        .nan_to_num(nan=torch.inf, posinf=torch.inf)
        .to(weights.dtype)
    )
    passed = torch.exp(-double(tau).sum(-1)).to(weights.dtype)
    # What the rest of the ray and the background get is 1 - m, and keeps its digits where m is almost 1.
    there, elsewhere = (
        (weights / (1 + squared)).sum(-1),
        (weights / (1 + 1 / squared)).sum(-1) + passed,
    )
    missed = torch.log1p(elsewhere / (there + doubt))
    return torch.where(close.any(-1), missed, 0.0).sum() / max(len(weights), 1)


@dataclass
class Stereo(Regularizer):
    """Weights lie where the photographs agree that something is: PatchMatch stereo, once before the first step.

    doubt: how likely it is that a depth is wrong. width, window, sources, tolerance: of the search, see `agreed_depth`.
    """

    weight: float = 0.01
    doubt: float = 0.1
    width: int = 512
    window: int = 9
    sources: int = 4
    tolerance: float = 1.0

    cite: ClassVar[str] = "deng2022dsnerf"

    def __post_init__(self) -> None:
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
        weights, tau, edges = (
            x[: len(known)] for x in (rendering.weights, rendering.tau, rendering.t_edges)
        )
        return {"stereo": missed_depth(weights, tau, edges, known, self.doubt)}

    @property
    def scale_free(self) -> bool:
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering) or given.rays.known_depth is None:
            return None
        weights, taus, edges = exact(given.weights), exact(given.tau), exact(given.t_edges)
        doubt, losses = mpmath.mpf(self.doubt), []
        for ray, (first, last) in enumerate(given.rays.known_depth.tolist()):
            pairs, half = list(pairwise(edges[ray])), (mpmath.mpf(last) - mpmath.mpf(first)) / 2
            off = [max(first - end, begin - last, mpmath.mpf(0)) for begin, end in pairs]
            trust = [mpmath.mpf(1) if x == 0 else half**2 / (half**2 + x**2) for x in off]
            there = mpmath.fsum(w * t for w, t in zip(weights[ray], trust, strict=True))
            elsewhere = mpmath.fsum(w * (1 - t) for w, t in zip(weights[ray], trust, strict=True))
            missed = (elsewhere + mpmath.exp(-mpmath.fsum(taus[ray]))) / (there + doubt)
            losses.append(mpmath.log1p(missed) if 0 in off else mpmath.mpf(0))
        return {"stereo": mpmath.fsum(losses) / max(len(losses), 1)}
