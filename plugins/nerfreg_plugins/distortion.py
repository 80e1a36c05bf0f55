"""Distortion: the weights of a ray gather in one place. Source: Mip-NeRF 360 (Barron et al. 2022), equation 15;
divided by depth as in CombiNeRF (Bonotto et al. 2024)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import mpmath
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg import Regularizer, Rendering, Step, hookimpl
from nerfreg.numerics import MIN_OPACITY, exact, single


def distortion(
    weights: Float[Tensor, "rays samples"],
    t_edges: Float[Tensor, "rays edges"],
    depth: Float[Tensor, " rays"],
) -> Float[Tensor, ""]:
    """(sum_ij w_i w_j abs(m_i - m_j) + 1/3 sum_i w_i^2 delta_i) / depth, mean over rays.

    weights: (R, N). t_edges: (R, N+1) ascending, with midpoints m and lengths delta. depth: (R,) in the unit of t.

    Every gap between neighbouring midpoints separates the weight before it from the weight after it, so that the
    double sum is 2 sum_k (m_{k+1} - m_k) W_{<=k} W_{>k}: O(N), and no term is negative, so nothing cancels. The gaps
    come from the lengths, which are exact where intervals are short against t; rounded midpoints are not.
    Rays with opacity below `MIN_OPACITY` count as 0.
    """
    weights, t_edges, depth = single(weights), single(t_edges), single(depth)
    delta = t_edges.diff(dim=-1)
    gaps = (delta[:, 1:] + delta[:, :-1]) / 2
    before = weights.cumsum(-1)[:, :-1]
    after = weights.flip(-1).cumsum(-1).flip(-1)[:, 1:]
    spread = 2 * (gaps * before * after).sum(-1) + (weights.square() * delta).sum(-1) / 3
    counted = (weights.detach().sum(-1) >= MIN_OPACITY) & (depth.detach() > 0)
    return torch.where(counted, spread / torch.where(counted, depth, 1.0), 0.0).mean()


@dataclass
class Distortion(Regularizer):
    """Weights of a ray gather in one place; relative to its depth (Mip-NeRF 360, CombiNeRF).

    detach_depth: no gradient through the divisor. max_rays: how many rays, chosen at random, count in a step (0: all).
    unit_depth: divide by the sum of w t, t in [0, 1] between the scene's bounds, plus 1e-4: what is faint costs more.
    drop_last: leave out the last interval.
    """

    weight: float = 2e-5
    # Iteration 1000 of the paper's 9000 to 12000; as a share, so that short runs have it too.
    start: int | float = 0.1
    detach_depth: bool = False
    max_rays: int = 0
    unit_depth: bool = False
    drop_last: bool = False

    by_layout: ClassVar[dict[str, dict[str, Any]]] = {
        "forward": {"weight": 2e-5},
        "orbit": {"weight": 2e-3},
    }
    cite: ClassVar[str] = "barron2022mipnerf360"

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Float[Tensor, ""]]:
        return {"distortion": distortion(*self._inputs(rendering, step))}

    def _inputs(
        self, rendering: Rendering, step: Step
    ) -> tuple[Float[Tensor, "rays samples"], Float[Tensor, "rays edges"], Float[Tensor, " rays"]]:
        weights, t_edges, depth = rendering.weights, rendering.t_edges, rendering.depth
        if self.unit_depth:
            near, far = step.bounds
            depth = rendering.opacity * (depth - near) / (far - near) + 1e-4
        if 0 < self.max_rays < len(weights):
            chosen = torch.randperm(len(weights), generator=step.generator)[: self.max_rays].to(
                weights.device
            )
            weights, t_edges, depth = weights[chosen], t_edges[chosen], depth[chosen]
        if self.drop_last:
            weights, t_edges = weights[:, :-1], t_edges[:, :-1]
        if self.detach_depth:
            depth = depth.detach()
        return weights, t_edges, depth

    @property
    def scale_free(self) -> bool:
        return not self.unit_depth

    @hookimpl
    def nerfreg_reference(self, given: Any, step: Step) -> dict[str, Any] | None:
        if not isinstance(given, Rendering):
            return None
        rays = zip(*map(exact, self._inputs(given, step)), strict=True)
        spreads = [_reference(*ray) for ray in rays]
        return {"distortion": mpmath.fsum(spreads) / len(spreads)}


def _reference(weights: list[Any], t_edges: list[Any], depth: Any) -> Any:
    """Equation 15 for one ray; the sum over pairs from running sums, whose cancellation so many digits afford."""
    if mpmath.fsum(weights) < MIN_OPACITY or depth <= 0:
        return 0
    total = weight = moment = mpmath.mpf(0)
    for w, low, high in zip(weights, t_edges, t_edges[1:], strict=False):
        middle = (low + high) / 2
        total += 2 * w * (middle * weight - moment) + w**2 * (high - low) / 3
        weight, moment = weight + w, moment + w * middle
    return total / depth
