"""KL divergence between the ray distributions of adjacent pixels.

Source: the information gain reduction of InfoNeRF (Kim et al. 2022), on weights instead of alphas
in CombiNeRF (Bonotto et al. 2024).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum, auto
from typing import Any, ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg import Needs, Regularizer, Rendering, Step, hookimpl
from nerfreg.numerics import MIN_OPACITY, double, exact, log_alpha, of_rays, single
from nerfreg_plugins.references import kl as reference

MIN_LOG_Q = math.log(1e-10)
"""Floor of the neighbour's log-probability: one sample may cost at most 23 nats."""
SERIES = 0.05
"""Below this log(q / p), q - p - p log(q / p) has lost digits, and its series has not."""


def kl_loss(
    weights: Float[Tensor, "pairs samples"] | Float[Tensor, "pairs samples 1"],
    neighbor_weights: Float[Tensor, "pairs samples"] | Float[Tensor, "pairs samples 1"],
) -> Float[Tensor, ""]:
    """Return D(p || q) = sum p log(p / q), mean over pairs of rays that share their t.

    p is w / sum w of a ray and q that of its neighbour, floored at 1e-10. A pair in which either
    ray has an opacity below `MIN_OPACITY` counts as 0. A weight of 0 has no gradient.

    Args:
        weights: Of the rays, `(M, N)` or `(M, N, 1)`.
        neighbor_weights: Of their neighbours, likewise.
    """
    weights = of_rays("weights", weights, 2)
    neighbor_weights = of_rays("neighbor_weights", neighbor_weights, 2, weights.shape[1])
    divergence = kl_loss_of_logs(_logs(weights), _logs(neighbor_weights))
    return divergence.to(single(weights).dtype)


def _logs(weights: Float[Tensor, "pairs samples"]) -> Float[Tensor, "pairs samples"]:
    """Return the logarithms of weights, -inf for those that are 0 and for empty rays."""
    weights = double(weights)
    # The slope of the logarithm at 0 is infinite and would make NaN of a gradient of 0.
    counted = (weights.detach() > 0) & (weights.detach().sum(-1, keepdim=True) >= MIN_OPACITY)
    return torch.where(counted, torch.where(counted, weights, 1.0).log(), -math.inf)


def kl_loss_of_logs(
    log_weights: Float[Tensor, "pairs samples"],
    neighbor_log_weights: Float[Tensor, "pairs samples"],
) -> Float[Tensor, ""]:
    """Return D(p || q) = sum p log(p / q), mean over pairs.

    p is w / sum w of a ray and q that of its neighbour at the same t. Both are normalised in log
    space, so that a common factor of all weights of a ray, however small, changes nothing. q is
    floored at 1e-10. A pair in which either ray has no weight at all counts as 0, and an empty
    batch is 0.

    Rays that nearly agree must not lose the small divergence between large logarithms. As
    sum p = sum q = 1, D is also sum (p log(p / q) - p + q), in which no term is negative unless q
    is floored. Computed in float64.

    Args:
        log_weights: Of the rays, `(M, N)`; -inf where a weight is 0.
        neighbor_log_weights: Of their neighbours, `(M, N)`.
    """
    ray, empty = _filled(double(log_weights))
    neighbor, neighbor_empty = _filled(double(neighbor_log_weights))
    divergence = torch.where(empty | neighbor_empty, 0.0, _divergence(ray, neighbor))
    return (divergence.sum() / max(len(log_weights), 1)).to(single(log_weights).dtype)


def _filled(
    log_weights: Float[Tensor, "pairs samples"],
) -> tuple[Float[Tensor, "pairs samples"], Bool[Tensor, " pairs"]]:
    """Make rays without any weight uniform, and tell which those are."""
    empty = (log_weights == -math.inf).all(-1)
    # The softmax of nothing but -inf is NaN, and NaN in a branch that `where` discards still
    # reaches the gradient.
    return torch.where(empty[:, None], 0.0, log_weights), empty


class _Divergence(torch.autograd.Function):
    """D of each pair.

    dD = sum dp log(p / q) - sum p dlog(q) needs none of the care by which D keeps its digits: the
    backward pass written out takes a quarter of the time of autograd through the forward pass.
    """

    @staticmethod
    def forward(ctx: Any, ray: Tensor, neighbor: Tensor) -> Tensor:
        log_p, log_q = ray.log_softmax(-1), neighbor.log_softmax(-1)
        p, q, floored = log_p.exp(), log_q.exp(), log_q < MIN_LOG_Q
        ctx.save_for_backward(log_p, log_q, p, q)
        compared = (p > 0) & ~floored
        ratio = torch.where(compared, _log_ratio(ray, neighbor, log_q - log_p, p), 0.0)
        apart = torch.where(ratio.abs() < SERIES, p * _expm1_minus(ratio), (q - p) - p * ratio)
        # Where p is 0 its logarithm is -inf, and 0 * -inf is NaN; 0 * (the lowest number) is 0.
        at_floor = p * (log_p.clamp_min(torch.finfo(log_p.dtype).min) - MIN_LOG_Q) + (q - p)
        # Where p is 0 and q is not floored, all that is left of p log(p / q) - p + q is q.
        return torch.where(compared, apart, torch.where(floored, at_floor, q)).sum(-1)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor]:
        log_p, log_q, p, q = ctx.saved_tensors
        cost = torch.where(p > 0, log_p - log_q.clamp_min(MIN_LOG_Q), 0.0)
        # A floored log q is constant, so that nothing flows through it to the neighbour.
        free = torch.where(log_q < MIN_LOG_Q, 0.0, p)
        grad = grads[0][:, None]
        # Both are backward passes of a softmax, which take away the mean under its distribution.
        ray_grad = p * (cost - (p * cost).sum(-1, keepdim=True))
        return grad * ray_grad, grad * (q * free.sum(-1, keepdim=True) - free)


_divergence: Callable[[Tensor, Tensor], Tensor] = _Divergence.apply


def _log_ratio(
    ray: Float[Tensor, "pairs samples"],
    neighbor: Float[Tensor, "pairs samples"],
    plain: Float[Tensor, "pairs samples"],
    p: Float[Tensor, "pairs samples"],
) -> Float[Tensor, "pairs samples"]:
    """Return log(q / p) from differences between the rays where these are small, else `plain`.

    With d the difference of the log-weights, log(q / p) = d - log sum p exp(d). Log-weights that
    are nearly equal are subtracted without rounding, while log p and log q have each been rounded
    at their own, larger size.
    """
    # Where both are -inf the difference is nan, and counts as none.
    difference = (neighbor - ray).nan_to_num(nan=0.0, posinf=math.inf, neginf=-math.inf)
    # log(q / p) does not change when a constant is taken from d. Without the difference at the
    # ray's peak, d is small even if one ray is far fainter than the other.
    difference = difference - difference.gather(-1, p.argmax(-1, keepdim=True))
    alike = difference.abs().amax(-1, keepdim=True) < 1
    small = torch.where(alike & (p > 0), difference, 0.0)
    return torch.where(alike, small - torch.log1p((p * small.expm1()).sum(-1, keepdim=True)), plain)


def _expm1_minus(x: Float[Tensor, "pairs samples"]) -> Float[Tensor, "pairs samples"]:
    """Return exp(x) - 1 - x for abs(x) < SERIES, to 1e-14 by its Taylor series."""
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


class KLDirection(StrEnum):
    """Which of the two rays comes first: D(ray || neighbour) is forward, the other reverse."""

    forward = auto()
    reverse = auto()


@dataclass
class KLDivergence(Regularizer):
    """Adjacent rays look alike: KL divergence of their weight distributions (InfoNeRF, CombiNeRF).

    Attributes:
        weight: CombiNeRF's, for all layouts.
        density: What is normalised: `weights` (CombiNeRF) or `alphas` (InfoNeRF).
        neighbors: `patch` pairs pixels inside patches at no extra cost, `extra` renders one more
            ray for each training ray.
        direction: `forward` is D(ray || neighbour), `reverse` is D(neighbour || ray).
        patch_fraction: Share of the training rays in patches, with `neighbors: patch`.
    """

    weight: float = 1e-5
    density: Density = Density.weights
    neighbors: Neighbors = Neighbors.patch
    direction: KLDirection = KLDirection.forward
    patch_fraction: float = 0.0625

    cite: ClassVar[str] = "kim2022infonerf, bonotto2024combinerf"

    @hookimpl
    def nerfreg_needs(self) -> Needs:
        if self.neighbors == Neighbors.extra:
            return Needs(neighbors="extra")
        return Needs(patch_size=2, patch_fraction=self.patch_fraction, neighbors="patch")

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Float[Tensor, ""]]:
        if rendering.rays.neighbors is None:
            return {}
        return {"kl": kl_loss_of_logs(*self._pairs(rendering))}

    def _pairs(
        self, rendering: Rendering
    ) -> tuple[Float[Tensor, "pairs samples"], Float[Tensor, "pairs samples"]]:
        assert rendering.rays.neighbors is not None
        density = (
            rendering.log_weights if self.density == Density.weights else log_alpha(rendering.tau)
        )
        # In log space even a ray of opacity 1e-30 has a distribution, but nothing is to be learnt
        # from the shape of what cannot be seen.
        density = density.masked_fill(~rendering.visible[:, None], -math.inf)
        ray, neighbor = (density[indices] for indices in rendering.rays.neighbors.unbind(1))
        return (ray, neighbor) if self.direction == KLDirection.forward else (neighbor, ray)

    @property
    def scale_free(self) -> bool:
        """True, since a distribution over samples has no unit."""
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering) or given.rays.neighbors is None:
            return None
        return {"kl": reference.kl_loss_of_logs(*map(exact, self._pairs(given)))}
