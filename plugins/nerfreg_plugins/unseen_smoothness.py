"""Depth is smooth where no photograph was taken. Source: RegNeRF (Niemeyer et al. 2022), section 4.1; relative
differences of depth are ours."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Any, ClassVar

import mpmath
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg import Needs, Regularizer, Rendering, hookimpl
from nerfreg.numerics import exact, single


def relative_smoothness(
    depth_patches: Float[Tensor, "patches side side"], visible: Bool[Tensor, "patches side side"]
) -> Float[Tensor, ""]:
    """Sum of the squared differences of log depth over all adjacent pixels, mean over patches.

    depth_patches: (P, S, S). visible: (P, S, S); pairs where either pixel is not visible, or has no positive depth, are
    left out. The logarithm is that of the ratio, so that nearly equal depths keep their digits. No patches give 0.
    """
    depth_patches = single(depth_patches)
    counted = visible & (depth_patches.detach() > 0)
    depth = torch.where(counted, depth_patches, 1.0)
    down = _squared_log_ratio(depth[:, :-1], depth[:, 1:], counted[:, :-1] & counted[:, 1:])
    right = _squared_log_ratio(
        depth[:, :, :-1], depth[:, :, 1:], counted[:, :, :-1] & counted[:, :, 1:]
    )
    return (down + right) / max(len(depth_patches), 1)


def _squared_log_ratio(first: Tensor, second: Tensor, counted: Tensor) -> Tensor:
    ratio = torch.where(counted, (second - first) / first, 0.0)
    return torch.log1p(ratio).square().sum()


@dataclass
class UnseenSmoothness(Regularizer):
    """Depth is smooth in views between the training views (RegNeRF); relative, so that near and far count alike.

    patch_size: side of the patches in pixels. share: of a step's rays that lie in such patches, in the place of
    training rays.
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
        return {
            "unseen_smoothness": relative_smoothness(
                rendering.depth[patches], rendering.visible[patches]
            )
        }

    @property
    def scale_free(self) -> bool:
        return True

    @hookimpl
    def nerfreg_reference(self, given: Any) -> dict[str, Any] | None:
        if not isinstance(given, Rendering) or given.rays.unseen_patches is None:
            return None
        depth, visible = exact(given.depth), given.visible.tolist()
        squares = []
        for patch in given.rays.unseen_patches.tolist():
            rows, columns = patch, list(zip(*patch, strict=True))
            for a, b in chain.from_iterable(map(pairwise, chain(rows, columns))):
                if visible[a] and visible[b] and depth[a] > 0 and depth[b] > 0:
                    squares.append(mpmath.log(depth[a] / depth[b]) ** 2)
        return {"unseen_smoothness": mpmath.fsum(squares) / max(len(given.rays.unseen_patches), 1)}
