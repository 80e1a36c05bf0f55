"""Depth is smooth where no photograph was taken.

Source: RegNeRF (Niemeyer et al. 2022), section 4.1; relative differences of depth are our own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg import Needs, Regularizer, Rendering, hookimpl
from nerfreg.numerics import exact, of_rays, single
from nerfreg_plugins.references import unseen_smoothness as reference


def unseen_smoothness_loss(
    depth_patches: Float[Tensor, "patches side side"] | Float[Tensor, "patches side side 1"],
    visible: Bool[Tensor, "patches side side"] | None = None,
) -> Float[Tensor, ""]:
    """Return the sum of log(d / d')^2 over all adjacent pixels, mean over patches.

    No patches give 0.

    Args:
        depth_patches: `(P, S, S)` or `(P, S, S, 1)`.
        visible: `(P, S, S)`; pairs are left out where either pixel is not visible, or has no
            positive depth. None: all are visible.
    """
    depth_patches = single(of_rays("depth_patches", depth_patches, 3))
    counted = depth_patches.detach() > 0
    if visible is not None:
        counted &= visible
    depth = torch.where(counted, depth_patches, 1.0)
    down = _squared_log_ratio(depth[:, :-1], depth[:, 1:], counted[:, :-1] & counted[:, 1:])
    right = _squared_log_ratio(
        depth[:, :, :-1], depth[:, :, 1:], counted[:, :, :-1] & counted[:, :, 1:]
    )
    return (down + right) / max(len(depth_patches), 1)


def _squared_log_ratio(first: Tensor, second: Tensor, counted: Tensor) -> Tensor:
    # The difference of two logarithms would lose the digits of nearly equal depths; the difference
    # of the depths themselves is exact.
    ratio = torch.where(counted, (second - first) / first, 0.0)
    return torch.log1p(ratio).square().sum()


@dataclass
class UnseenSmoothness(Regularizer):
    """Depth is smooth in views between the training views (RegNeRF), relative to depth itself.

    Near and far surfaces count alike, and the unit of length does not matter.

    Attributes:
        weight: Our own, from views held out of the training views of fern.
        patch_size: Side of the patches in pixels; RegNeRF's.
        share: Share of a step's rays that lie in such patches. They take the place of training
            rays.
    """

    weight: float = 0.03
    patch_size: int = 8
    share: float = 0.125

    cite: ClassVar[str] = "niemeyer2022regnerf"

    @hookimpl
    def nerfreg_needs(self) -> Needs:
        return Needs(patch_size=self.patch_size, unseen_patches=self.share)

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Float[Tensor, ""]]:
        patches = rendering.rays.unseen_patches
        if patches is None:
            return {}
        term = unseen_smoothness_loss(rendering.depth[patches], rendering.visible[patches])
        return {"unseen_smoothness": term}

    @property
    def scale_free(self) -> bool:
        """True, since only ratios of depths count."""
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering) or given.rays.unseen_patches is None:
            return None
        patches = given.rays.unseen_patches
        depth, visible = exact(given.depth[patches]), given.visible[patches].tolist()
        return {"unseen_smoothness": reference.unseen_smoothness_loss(depth, visible)}
