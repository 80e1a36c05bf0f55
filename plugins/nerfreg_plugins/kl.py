"""KL divergence between the ray distributions of adjacent pixels.

Source: the information gain reduction of InfoNeRF (Kim et al. 2022), on weights instead of alphas in CombiNeRF
(Bonotto et al. 2024).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum, auto
from typing import Any, ClassVar

import mpmath
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg import Needs, Regularizer, Rendering, Step, hookimpl
from nerfreg.numerics import double, exact, log_alpha, single

MIN_LOG_Q = math.log(1e-10)
"""Floor of the neighbour's log-probability: one sample may cost at most 23 nats."""
SERIES = 0.05
"""Below this log(q / p), q - p - p log(q / p) has lost digits, and its series has not."""


def kl_divergence(
    log_weights: Float[Tensor, "pairs samples"],
    neighbor_log_weights: Float[Tensor, "pairs samples"],
) -> Float[Tensor, ""]:
    """D(p || q) = sum p log(p / q), p = w / sum w of a ray and q of its neighbour at the same t; mean over pairs.

    log_weights, neighbor_log_weights: (M, N), -inf where a weight is 0. Normalised in log space, so that a common
    factor of all weights of a ray, however small, changes nothing. q is floored at 1e-10. A pair in which either
    ray has no weight at all counts as 0; so does an empty batch.

    Rays that nearly agree must not lose the small divergence between large logarithms. As sum p = sum q = 1, D is also
    sum (p log(p / q) - p + q), in which no term is negative but where q is floored. Computed in float64.
    """
    ray, empty = _filled(double(log_weights))
    neighbor, neighbor_empty = _filled(double(neighbor_log_weights))
    divergence = torch.where(empty | neighbor_empty, 0.0, _Divergence.apply(ray, neighbor))
    return (divergence.sum() / max(len(log_weights), 1)).to(single(log_weights).dtype)


def _filled(
    log_weights: Float[Tensor, "pairs samples"],
) -> tuple[Float[Tensor, "pairs samples"], Bool[Tensor, " pairs"]]:
    """The same with rays that have no weight at all made uniform, and which those are."""
    empty = (log_weights == -math.inf).all(-1)
    return torch.where(empty[:, None], 0.0, log_weights), empty


class _Divergence(torch.autograd.Function):
    """D of each pair. Its gradient, dD = sum dp log(p / q) - sum p dlog(q), needs nothing of how D keeps its digits."""

    @staticmethod
    def forward(ctx: Any, ray: Tensor, neighbor: Tensor) -> Tensor:
        log_p, log_q = ray.log_softmax(-1), neighbor.log_softmax(-1)
        p, q, floored = log_p.exp(), log_q.exp(), log_q < MIN_LOG_Q
        ctx.save_for_backward(log_p, log_q, p, q)
        compared = (p > 0) & ~floored
        ratio = torch.where(compared, _log_ratio(ray, neighbor, log_q - log_p, p), 0.0)
        apart = torch.where(ratio.abs() < SERIES, p * _expm1_minus(ratio), (q - p) - p * ratio)
        at_floor = p * (log_p.clamp_min(torch.finfo(log_p.dtype).min) - MIN_LOG_Q) + (q - p)
        return torch.where(compared, apart, torch.where(floored, at_floor, q)).sum(-1)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor]:
        log_p, log_q, p, q = ctx.saved_tensors
        cost = torch.where(p > 0, log_p - log_q.clamp_min(MIN_LOG_Q), 0.0)
        free = torch.where(log_q < MIN_LOG_Q, 0.0, p)
        grad = grads[0][:, None]
        ray_grad = p * (cost - (p * cost).sum(-1, keepdim=True))
        return grad * ray_grad, grad * (q * free.sum(-1, keepdim=True) - free)


def _log_ratio(
    ray: Float[Tensor, "pairs samples"],
    neighbor: Float[Tensor, "pairs samples"],
    plain: Float[Tensor, "pairs samples"],
    p: Float[Tensor, "pairs samples"],
) -> Float[Tensor, "pairs samples"]:
    """log(q / p), from the differences between two rays where these are small and exact, else `plain`."""
    # Where both are -inf the difference is nan, and counts as none.
    difference = (neighbor - ray).nan_to_num(nan=0.0, posinf=math.inf, neginf=-math.inf)
    difference = difference - difference.gather(-1, p.argmax(-1, keepdim=True))
    alike = difference.abs().amax(-1, keepdim=True) < 1
    small = torch.where(alike & (p > 0), difference, 0.0)
    return torch.where(alike, small - torch.log1p((p * small.expm1()).sum(-1, keepdim=True)), plain)


def _expm1_minus(x: Float[Tensor, "pairs samples"]) -> Float[Tensor, "pairs samples"]:
    """exp(x) - 1 - x for abs(x) < SERIES, to 1e-14 by its Taylor series."""
    series = torch.ones_like(x)
    for order in range(10, 2, -1):
        series = 1 + x / order * series
    return x.square() / 2 * series


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

    cite: ClassVar[str] = "kim2022infonerf, bonotto2024combinerf"

    @hookimpl
    def nerfreg_needs(self) -> Needs:
        if self.neighbors == Neighbors.extra:
            return Needs(neighbors="extra")
        return Needs(patch_size=2, patch_fraction=self.patch_fraction, neighbors="patch")

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Float[Tensor, ""]]:
        return (
            {}
            if rendering.rays.neighbors is None
            else {"kl": kl_divergence(*self._pairs(rendering))}
        )

    def _pairs(
        self, rendering: Rendering
    ) -> tuple[Float[Tensor, "pairs samples"], Float[Tensor, "pairs samples"]]:
        assert rendering.rays.neighbors is not None
        density = (
            rendering.log_weights if self.density == Density.weights else log_alpha(rendering.tau)
        )
        density = density.masked_fill(~rendering.visible[:, None], -math.inf)
        ray, neighbor = (
            density[rendering.rays.neighbors[:, 0]],
            density[rendering.rays.neighbors[:, 1]],
        )
        return (ray, neighbor) if self.direction == Direction.forward else (neighbor, ray)

    @property
    def scale_free(self) -> bool:
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering) or given.rays.neighbors is None:
            return None
        rays, neighbors = map(exact, self._pairs(given))
        divergences = [
            _reference(ray, neighbor) for ray, neighbor in zip(rays, neighbors, strict=True)
        ]
        return {"kl": mpmath.fsum(divergences) / max(len(divergences), 1)}


def _reference(ray: list[Any], neighbor: list[Any]) -> Any:
    """The definition, literally."""
    weights, others = ([mpmath.exp(x) for x in log_weights] for log_weights in (ray, neighbor))
    total, other_total = mpmath.fsum(weights), mpmath.fsum(others)
    if total == 0 or other_total == 0:
        return 0
    pairs = (
        (w / total, max(v / other_total, mpmath.mpf(1e-10)))
        for w, v in zip(weights, others, strict=True)
    )
    return mpmath.fsum(p * mpmath.log(p / q) for p, q in pairs if p > 0)
