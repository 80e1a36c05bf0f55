"""Pictures of renderings: colour, depth, error, side by side."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from nerfreg.files import atomic

ERROR_RANGE = 0.5
"""Mean absolute colour error shown as the brightest."""


def to_uint8(image: Float[Tensor, "height width 3"]) -> UInt8[np.ndarray, "height width 3"]:
    """Colours in [0, 1], clipped and rounded to bytes; nan becomes black."""
    return (image.detach().nan_to_num(0.0).clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()


def save_png(path: Path, image: Float[Tensor, "height width 3"]) -> None:
    """Write an image in [0, 1], whole or not at all."""
    import imageio.v3 as iio

    with atomic(path) as part:
        iio.imwrite(part, to_uint8(image))


def color_map(values: Float[Tensor, "height width"], name: str) -> Float[Tensor, "height width 3"]:
    """Values in [0, 1] as colours of a matplotlib colour map; those outside take the nearest end."""
    table = _table(name)
    return table[(values.nan_to_num(0.0).clamp(0, 1) * (len(table) - 1)).round().long()]


def depth_image(
    depth: Float[Tensor, "height width"],
    near: float,
    far: float,
    opacity: Float[Tensor, "height width"],
) -> Float[Tensor, "height width 3"]:
    """Depth as colour, bright where near, dark blue at far, fading to black as rays are empty.

    The scale is logarithmic between near and far, so that equal ratios of distance look equally different.
    """
    near = max(near, 1e-3 * far)  # a near of 0 has no logarithm
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
    """Colour and depth beside each other; with a target also that and the error (mean absolute, 0.5 is brightest)."""
    rgb = rgb.detach().clamp(0, 1)
    panels = [rgb, depth_image(depth, near, far, opacity)]
    if target is not None:
        panels += [target, color_map((rgb - target).abs().mean(-1) / ERROR_RANGE, "magma")]
    return torch.cat(panels, dim=1)


@cache
def _table(name: str) -> Float[Tensor, "entries 3"]:
    import matplotlib

    return torch.from_numpy(matplotlib.colormaps[name](np.linspace(0, 1, 256))[:, :3]).float()
