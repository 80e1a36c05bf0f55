"""The exact twin of the compositor, in many digits; `nerfreg check` compares the two."""

from __future__ import annotations

from typing import Any

import mpmath
from jaxtyping import Float
from torch import Tensor

from nerfreg.numerics import MIN_OPACITY, exact
from nerfreg.registry.hooks import REFERENCE_DIGITS

PARTS = ("weights", "log_transmittance", "opacity", "depth", "rgb")


def composite_exactly(
    sigma: Float[Tensor, "rays samples"],
    rgb: Float[Tensor, "rays samples 3"],
    t_edges: Float[Tensor, "rays edges"],
    background: Float[Tensor, "rays 3"] | None = None,
) -> dict[str, list[Any]]:
    """Return `PARTS` of what `composite` makes of tensors that count as exact, a row for each ray.

    See `nerfreg.rendering.compositing.composite` for the arguments.
    """
    with mpmath.workdps(REFERENCE_DIGITS):
        backgrounds = [[0, 0, 0]] * len(sigma) if background is None else exact(background)
        given = zip(exact(sigma), exact(rgb), exact(t_edges), backgrounds, strict=True)
        rays = [_ray(*ray) for ray in given]
    return dict(zip(PARTS, map(list, zip(*rays, strict=True)), strict=True))


def _ray(sigma: list[Any], rgb: list[Any], edges: list[Any], background: list[Any]) -> list[Any]:
    passed, light, moment = mpmath.mpf(0), mpmath.mpf(1), mpmath.mpf(0)
    weights, logs, color = [], [], [mpmath.mpf(0)] * 3
    for density, hue, low, high in zip(sigma, rgb, edges, edges[1:], strict=False):
        logs.append(-passed)
        tau = density * (high - low)
        # Products, not differences: exp(-1e-12) is close to 1, and what is left of 1 is the weight.
        weight = light * -mpmath.expm1(-tau)
        weights.append(weight)
        passed += tau
        light = mpmath.exp(-passed)
        color = [c + weight * h for c, h in zip(color, hue, strict=True)]
        moment += weight * (low + high) / 2
    opacity = -mpmath.expm1(-passed)  # the sum of the weights
    depth = moment / opacity if opacity >= MIN_OPACITY else edges[-1]
    seen = [c + light * b for c, b in zip(color, background, strict=True)]
    return [weights, logs, opacity, depth, seen]
