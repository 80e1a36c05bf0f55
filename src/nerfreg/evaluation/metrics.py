"""Scores of one image against its photograph. Nothing here changes its arguments."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

SSIM_WINDOW = 11
"""Side of the gaussian window of SSIM, pixels (sigma 1.5)."""


def psnr(image: Float[Tensor, "height width 3"], target: Float[Tensor, "height width 3"]) -> float:
    """Peak signal-to-noise ratio in dB, -10 log10(MSE), of images in [0, 1]; inf where they are identical."""
    error = (image.double() - target.double()).square().mean().item()
    return math.inf if error == 0.0 else -10.0 * math.log10(error)


@torch.no_grad()
def ssim(
    image: Float[Tensor, "height width 3"], target: Float[Tensor, "height width 3"]
) -> float | None:
    """Structural similarity (Wang et al. 2004) of images in [0, 1]; None where the window does not fit into them."""
    from torchmetrics.functional.image import structural_similarity_index_measure

    if min(image.shape[:2]) < SSIM_WINDOW:
        return None
    channels_first, target_first = (
        image.movedim(-1, 0).contiguous(),
        target.movedim(-1, 0).contiguous(),
    )
    value = structural_similarity_index_measure(
        channels_first[None], target_first[None], sigma=1.5, data_range=1.0
    )
    assert isinstance(value, Tensor)
    return value.item()


def average(psnr: float, ssim: float | None, lpips: float | None) -> float | None:
    """The geometric mean of three errors, the cube root of 10^(-PSNR/10) sqrt(1-SSIM) LPIPS; None if one is missing.

    Lower is better; 0 where any of the three errors is 0.
    """
    if ssim is None or lpips is None:
        return None
    # rounding may carry the SSIM of equal images just above 1
    return math.cbrt(10.0 ** (-psnr / 10.0) * math.sqrt(max(0.0, 1.0 - ssim)) * lpips)


def depth_rmse(
    depth: Float[Tensor, "height width"], truth: Float[Tensor, "height width"]
) -> float | None:
    """Root of the mean squared depth error, world units, over pixels where the truth is finite; None without any.

    An empty ray counts with the depth it was given, `far`: a hole in a surface is an error.
    """
    known = truth.isfinite()
    if not known.any():
        return None
    return (depth[known].double() - truth[known].double()).square().mean().sqrt().item()
