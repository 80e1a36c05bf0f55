"""Pictures of renderings: colour, depth and error, side by side."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from nerfreg.files import atomic

ERROR_RANGE = 0.5
"""Mean absolute colour error that is shown as the brightest."""


def to_uint8(image: Float[Tensor, "height width 3"]) -> UInt8[np.ndarray, "height width 3"]:
    """Convert colours in [0, 1] to bytes, clipped and rounded; NaN becomes black."""
    # Without the rounding the conversion truncates, and the image would be darker by half a level.
    return (image.detach().nan_to_num(0.0).clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()


def save_png(path: Path, image: Float[Tensor, "height width 3"]) -> None:
    """Write an image as PNG.

    Args:
        path: The file, which is replaced as a whole or left as it was.
        image: Colours in [0, 1].

    Raises:
        NerfregError: If the file cannot be written.
    """
    import imageio.v3 as iio

    with atomic(path) as part:
        iio.imwrite(part, to_uint8(image))


def color_map(values: Float[Tensor, "height width"], name: str) -> Float[Tensor, "height width 3"]:
    """Show values as the colours of a matplotlib colour map.

    Args:
        values: Values in [0, 1]. Those outside get the colour of the nearest end, NaN that of 0.
        name: Name of the colour map.

    Returns:
        Colours in [0, 1].
    """
    table = _table(name)
    return table[(values.nan_to_num(0.0).clamp(0, 1) * (len(table) - 1)).round().long()]


def depth_image(
    depth: Float[Tensor, "height width"],
    near: float,
    far: float,
    opacity: Float[Tensor, "height width"],
) -> Float[Tensor, "height width 3"]:
    """Show depth as colour, bright where near and dark blue at far, fading to black on empty rays.

    The scale is logarithmic, so that equal ratios of distance look equally different.

    Args:
        depth: Distance along the rays, in world units.
        near: Distance that is shown brightest.
        far: Distance that is shown darkest.
        opacity: Opacity of the rays, which scales their brightness.

    Returns:
        Colours in [0, 1].
    """
    # A near of 0 has no logarithm.
    near = max(near, 1e-3 * far)
    depth = depth.detach().clamp(near, far)
    closeness = torch.log(far / depth) / np.log(far / near)
    return color_map(closeness, "viridis") * opacity.detach().nan_to_num(0.0).clamp(0, 1).unsqueeze(
        -1
    )


def side_by_side(
    rgb: Float[Tensor, "height width 3"],
    depth: Float[Tensor, "height width"],
    near: float,
    far: float,
    opacity: Float[Tensor, "height width"],
    target: Float[Tensor, "height width 3"] | None = None,
) -> Float[Tensor, "height panels 3"]:
    """Place colour and depth beside each other, and if there is a target, that and the error.

    Args:
        rgb: Rendered colours.
        depth: Rendered distances along the rays, in world units.
        near: Distance that is shown brightest.
        far: Distance that is shown darkest.
        opacity: Opacity of the rays.
        target: The photograph.

    Returns:
        The panels from left to right; the error is the mean over channels of absolute differences,
        brightest from `ERROR_RANGE` on.
    """
    rgb = rgb.detach().clamp(0, 1)
    panels = [rgb, depth_image(depth, near, far, opacity)]
    if target is not None:
        panels += [target, color_map((rgb - target).abs().mean(-1) / ERROR_RANGE, "magma")]
    return torch.cat(panels, dim=1)


@cache
def _table(name: str) -> Float[Tensor, "entries 3"]:
    import matplotlib

    return torch.from_numpy(matplotlib.colormaps[name](np.linspace(0, 1, 256))[:, :3]).float()
