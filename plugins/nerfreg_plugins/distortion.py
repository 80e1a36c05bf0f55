"""Distortion: the weights of a ray gather in one place.

Source: Mip-NeRF 360 (Barron et al. 2022), equation 15; divided by depth as in CombiNeRF
(Bonotto et al. 2024).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg import Regularizer, Rendering, Step, hookimpl
from nerfreg.numerics import MIN_OPACITY, exact, of_rays, ray_samples, single
from nerfreg_plugins.references import distortion as reference


def distortion_loss(
    weights: Float[Tensor, "rays samples"] | Float[Tensor, "rays samples 1"],
    t_edges: Float[Tensor, "rays edges"] | Float[Tensor, "rays edges 1"],
    depth: Float[Tensor, " rays"] | Float[Tensor, "rays 1"] | None = None,
) -> Float[Tensor, ""]:
    """Return (sum_ij w_i w_j abs(m_i - m_j) + 1/3 sum_i w_i^2 delta_i) / depth, mean over rays.

    Every gap between neighbouring midpoints m separates the weight before it from the weight after
    it, so that the double sum is 2 sum_k (m_{k+1} - m_k) W_{<=k} W_{>k}. This takes O(N), and as no
    term is negative, nothing cancels. Rays with opacity below `MIN_OPACITY` count as 0.

    Args:
        weights: `(R, N)` or `(R, N, 1)`.
        t_edges: Interval borders in ascending order, `(R, N+1)` or `(R, N+1, 1)`, with lengths
            delta.
        depth: What each ray is divided by, `(R,)` or `(R, 1)`, in the unit of t; None: its expected
            depth, sum w m / sum w. `torch.ones` leaves equation 15 as it is.
    """
    weights, t_edges = (single(x) for x in ray_samples(weights, t_edges))
    depth = _depth(weights, t_edges) if depth is None else single(of_rays("depth", depth, 1))
    delta = t_edges.diff(dim=-1)
    # From the lengths, which are exact where intervals are short against t. Midpoints would be
    # rounded before they are subtracted, and samples packed between 10000 and 10001 would lose most
    # of their digits in float32.
    gaps = (delta[:, 1:] + delta[:, :-1]) / 2
    before = weights.cumsum(-1)[:, :-1]
    # Added up from the far end, since the total minus `before` would cancel.
    after = weights.flip(-1).cumsum(-1).flip(-1)[:, 1:]
    spread = 2 * (gaps * before * after).sum(-1) + (weights.square() * delta).sum(-1) / 3
    counted = (weights.detach().sum(-1) >= MIN_OPACITY) & (depth.detach() > 0)
    # The divisor is replaced as well, since 0 / 0 makes the gradient NaN even where the outer
    # `where` discards it.
    return torch.where(counted, spread / torch.where(counted, depth, 1.0), 0.0).mean()


def _depth(
    weights: Float[Tensor, "rays samples"], t_edges: Float[Tensor, "rays edges"]
) -> Float[Tensor, " rays"]:
    """Return the expected depth, 0 for empty rays."""
    opacity = weights.sum(-1)
    seen = opacity.detach() >= MIN_OPACITY
    middle = (t_edges[:, 1:] + t_edges[:, :-1]) / 2
    return torch.where(seen, (weights * middle).sum(-1) / torch.where(seen, opacity, 1.0), 0.0)


@dataclass
class Distortion(Regularizer):
    """Weights of a ray gather in one place, relative to its depth (Mip-NeRF 360, CombiNeRF).

    Attributes:
        weight: 2e-5 where the cameras face forward, 2e-3 on orbits; both are CombiNeRF's.
        start: When the term sets in. CombiNeRF has iteration 1000 of 9000 to 12000.
        detach_depth: Let no gradient pass through the divisor, which otherwise pushes matter away
            from the camera.
        max_rays: How many rays, chosen at random, count in a step; 0 for all.
        unit_depth: Divide by the sum of w t plus 1e-4, with t in [0, 1] between the scene's
            bounds, as CombiNeRF's program does. Faint matter then costs more.
        drop_last: Leave out the last interval, as CombiNeRF's program does.
    """

    weight: float = 2e-5
    # A share of the budget and not a number of steps, so that short runs have the term too.
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
        return {"distortion": distortion_loss(*self._inputs(rendering, step))}

    def _inputs(
        self, rendering: Rendering, step: Step
    ) -> tuple[Float[Tensor, "rays samples"], Float[Tensor, "rays edges"], Float[Tensor, " rays"]]:
        weights, t_edges, depth = rendering.weights, rendering.t_edges, rendering.depth
        if self.unit_depth:
            near, far = step.bounds
            # Opacity times depth is the sum of w t, since depth is divided by opacity.
            depth = rendering.opacity * (depth - near) / (far - near) + 1e-4
        if 0 < self.max_rays < len(weights):
            # Drawn on the CPU by the run's own generator, so that a seed means the same everywhere.
            order = torch.randperm(len(weights), generator=step.generator)
            chosen = order[: self.max_rays].to(weights.device)
            weights, t_edges, depth = weights[chosen], t_edges[chosen], depth[chosen]
        if self.drop_last:
            weights, t_edges = weights[:, :-1], t_edges[:, :-1]
        if self.detach_depth:
            depth = depth.detach()
        return weights, t_edges, depth

    @property
    def scale_free(self) -> bool:
        """Whether the divisor has the unit of t, which then cancels."""
        return not self.unit_depth

    @hookimpl
    def nerfreg_reference(self, given: Any, step: Step) -> dict[str, Any] | None:
        if not isinstance(given, Rendering):
            return None
        return {"distortion": reference.distortion_loss(*map(exact, self._inputs(given, step)))}
