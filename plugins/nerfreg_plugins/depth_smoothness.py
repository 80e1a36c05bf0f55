"""Depth smoothness on patches of adjacent pixels.

Source: RegNeRF (Niemeyer et al. 2022), used by CombiNeRF (Bonotto et al. 2024).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum, auto
from typing import Any, ClassVar

from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg import Needs, Regularizer, Rendering, Step, hookimpl
from nerfreg.numerics import exact, of_rays, single
from nerfreg_plugins.references import depth_smoothness as reference


def depth_smoothness_loss(
    depth_patches: Float[Tensor, "patches side side"] | Float[Tensor, "patches side side 1"],
    visible: Bool[Tensor, "patches side side"] | None = None,
    opacity: Float[Tensor, "patches side side"] | None = None,
) -> Float[Tensor, ""]:
    """Return the sum of (d_ij - d_{i+1,j})^2 + (d_ij - d_{i,j+1})^2, mean over patches.

    The sum runs over i, j = 1..S-1. Patches of one pixel, and no patches, give 0.

    Args:
        depth_patches: `(P, S, S)` or `(P, S, S, 1)`.
        visible: `(P, S, S)`; differences with a pixel that is not visible are left out. None: all
            are visible.
        opacity: `(P, S, S)`, a factor of both differences that start at pixel ij; 1 if None.
    """
    depth_patches = single(of_rays("depth_patches", depth_patches, 3))
    # What is not visible may have any depth, even infinity, whose difference times False is NaN.
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

    Depth is normalised to [0, 1] between the scene's near and far.

    Attributes:
        weight: 0.1 where the cameras face forward, 0.01 on orbits; both are CombiNeRF's.
        patch_size: Side of the patches in pixels.
        patch_fraction: Share of the training rays that lie in patches.
        reduction: `sum` over a patch, or `mean` over the (S-1)^2 pixels that start differences.
        opacity_weighted: Multiply each difference by the opacity of its pixel, through which
            gradients flow, as CombiNeRF's program does.
    """

    # A batch of nothing but patches costs quality, since the pixels of a patch say nearly the
    # same. With a sixteenth of the rays in patches the others stay random.
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
        # Normalised after the differences are taken: depths far from the origin would lose their
        # differences by rounding.
        term = depth_smoothness_loss(rendering.depth[patches], rendering.visible[patches], opacity)
        return {"depth_smoothness": term * self._factor(patches.shape[-1], step)}

    def _factor(self, side: int, step: Step) -> float:
        near, far = step.bounds
        reduced = max(side - 1, 1) ** 2 if self.reduction == Reduction.mean else 1
        return 1 / (far - near) ** 2 / reduced if far > near else 0.0

    @property
    def scale_free(self) -> bool:
        """True, since depth is normalised by the scene's bounds."""
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any, step: Step) -> dict[str, Any] | None:
        if not isinstance(given, Rendering) or given.rays.patches is None:
            return None
        patches = given.rays.patches
        opacity = exact(given.opacity[patches]) if self.opacity_weighted else None
        visible = given.visible[patches].tolist()
        term = reference.depth_smoothness_loss(exact(given.depth[patches]), visible, opacity)
        return {"depth_smoothness": term * self._factor(patches.shape[-1], step)}
