"""Depth smoothness on patches of adjacent pixels. Source: RegNeRF (Niemeyer et al. 2022), used by CombiNeRF."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum, auto
from itertools import pairwise
from typing import Any, ClassVar

import mpmath
from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg import Needs, Regularizer, Rendering, Step, hookimpl
from nerfreg.numerics import exact, single


def depth_smoothness(
    depth_patches: Float[Tensor, "patches side side"],
    visible: Bool[Tensor, "patches side side"] | None = None,
    opacity: Float[Tensor, "patches side side"] | None = None,
) -> Float[Tensor, ""]:
    """Sum over i, j = 1..S-1 of (d_ij - d_{i+1,j})^2 + (d_ij - d_{i,j+1})^2, mean over patches.

    depth_patches: (P, S, S). visible: (P, S, S), terms where either pixel is not visible are left out; None: all
    are. opacity: (P, S, S), a factor of the terms of pixel ij; None: 1. Patches of one pixel, and no patches, give 0.
    """
    depth_patches = single(depth_patches)
    depth = depth_patches if visible is None else depth_patches.where(visible, 0.0)
    down = (depth[:, :-1, :-1] - depth[:, 1:, :-1]).square()
    right = (depth[:, :-1, :-1] - depth[:, :-1, 1:]).square()
    if visible is not None:
        down = down * (visible[:, :-1, :-1] & visible[:, 1:, :-1])
        right = right * (visible[:, :-1, :-1] & visible[:, :-1, 1:])
    terms = down + right if opacity is None else (down + right) * opacity[:, :-1, :-1]
    return terms.sum() / max(len(depth_patches), 1)


class Reduction(StrEnum):
    """How the terms of one patch are reduced."""

    sum = auto()
    mean = auto()


@dataclass
class DepthSmoothness(Regularizer):
    """Adjacent pixels have similar depth (RegNeRF, CombiNeRF).

    Depth is normalised to [0, 1] between the scene's near and far. patch_size: side of the patches in pixels.
    patch_fraction: share of the training rays in patches. reduction: `sum` over a patch, or `mean` over its
    (S-1)^2 pixels. opacity_weighted: each term times the opacity of its pixel.
    """

    weight: float = 0.1
    patch_size: int = 4
    patch_fraction: float = 0.0625
    reduction: Reduction = Reduction.sum
    opacity_weighted: bool = False

    by_layout: ClassVar[dict[str, dict[str, Any]]] = {
        "forward": {"weight": 0.1},
        "orbit": {"weight": 0.01},
    }
    cite: ClassVar[str] = "niemeyer2022regnerf"

    @hookimpl
    def nerfreg_needs(self) -> Needs:
        return Needs(patch_size=self.patch_size, patch_fraction=self.patch_fraction)

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Float[Tensor, ""]]:
        patches = rendering.rays.patches
        if patches is None:
            return {}
        opacity = rendering.opacity[patches] if self.opacity_weighted else None
        # Normalised after the differences are taken: depths far from the origin would lose theirs by rounding.
        term = depth_smoothness(rendering.depth[patches], rendering.visible[patches], opacity)
        return {"depth_smoothness": term * self._factor(patches.shape[-1], step)}

    def _factor(self, side: int, step: Step) -> float:
        near, far = step.bounds
        reduced = max(side - 1, 1) ** 2 if self.reduction == Reduction.mean else 1
        return 1 / (far - near) ** 2 / reduced if far > near else 0.0

    @property
    def scale_free(self) -> bool:
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any, step: Step) -> dict[str, Any] | None:
        if not isinstance(given, Rendering) or given.rays.patches is None:
            return None
        depth, opacity, visible = exact(given.depth), exact(given.opacity), given.visible.tolist()
        terms = []
        for patch in given.rays.patches.tolist():
            for row, below in pairwise(patch):
                for ray, right, down in zip(row, row[1:], below, strict=False):
                    squares = [
                        (depth[ray] - depth[to]) ** 2
                        for to in (right, down)
                        if visible[ray] and visible[to]
                    ]
                    terms.append(
                        mpmath.fsum(squares) * (opacity[ray] if self.opacity_weighted else 1)
                    )
        patches, side, _ = given.rays.patches.shape
        return {"depth_smoothness": mpmath.fsum(terms) / max(patches, 1) * self._factor(side, step)}
