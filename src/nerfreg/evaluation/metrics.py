"""Scores of one image against its photograph, as pure functions."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

SSIM_WINDOW = 11
"""Side of the Gaussian window of SSIM in pixels; torchmetrics derives 11 from a sigma of 1.5."""


def psnr(image: Float[Tensor, "height width 3"], target: Float[Tensor, "height width 3"]) -> float:
    """Compute the peak signal-to-noise ratio, -10 log10(MSE).

    Args:
        image: An image in [0, 1].
        target: An image in [0, 1] of the same size.

    Returns:
        The ratio in dB; inf if the images are identical.
    """
    # Sums over a million squares of small errors lose digits in float32.
    error = (image.double() - target.double()).square().mean().item()
    return math.inf if error == 0.0 else -10.0 * math.log10(error)


@torch.no_grad()
def ssim(
    image: Float[Tensor, "height width 3"], target: Float[Tensor, "height width 3"]
) -> float | None:
    """Compute the structural similarity (Wang et al. 2004), with a Gaussian window of sigma 1.5.

    Args:
        image: An image in [0, 1].
        target: An image in [0, 1] of the same size.

    Returns:
        The similarity; None if a side is shorter than the window.
    """
    # torchmetrics takes long to import, and evaluations of strided pixels do without SSIM.
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
    """Compute the geometric mean of three errors, cbrt(10^(-PSNR/10) sqrt(1-SSIM) LPIPS).

    Args:
        psnr: Peak signal-to-noise ratio in dB.
        ssim: Structural similarity.
        lpips: Perceptual distance.

    Returns:
        The mean, of which less is better and which is 0 if any error is; None if one is missing.
    """
    if ssim is None or lpips is None:
        return None
    # Rounding may carry the SSIM of equal images just above 1.
    return math.cbrt(10.0 ** (-psnr / 10.0) * math.sqrt(max(0.0, 1.0 - ssim)) * lpips)


def depth_rmse(
    depth: Float[Tensor, "height width"], truth: Float[Tensor, "height width"]
) -> float | None:
    """Compute the root mean squared error of depth where the truth is finite.

    Args:
        depth: Rendered distances along the rays, in world units.
        truth: True distances, inf or NaN where there are none.

    Returns:
        The error in world units; None if the truth is finite nowhere.
    """
    # Empty rays are not left out, but count with the depth that they have, `far`: a hole in a
    # surface is an error.
    known = truth.isfinite()
    if not known.any():
        return None
    return (depth[known].double() - truth[known].double()).square().mean().sqrt().item()
