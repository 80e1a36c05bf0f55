"""Image files: found, checked by their headers, read as float tensors, made smaller."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import imageio.v3 as iio
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.errors import NerfregError

EXTENSIONS = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG", ".webp", ".tif", ".tiff")


class ImageHeader(NamedTuple):
    """What the header of an image file says."""

    width: int
    height: int
    has_alpha: bool


def find_image(path: Path) -> Path:
    """The file that a path names, which may lack its extension. Returns `path` itself if there is none."""
    if path.is_file():
        return path
    candidates = (path.with_name(path.name + extension) for extension in EXTENSIONS)
    return next((candidate for candidate in candidates if candidate.is_file()), path)


def list_images(folder: Path) -> list[Path]:
    """All images of a folder, sorted by name."""
    return sorted(
        path
        for path in folder.iterdir()
        if path.suffix in EXTENSIONS and not path.name.startswith(".")
    )


def read_header(path: Path) -> ImageHeader:
    """Size and channels of an image, without decoding it."""
    try:
        shape = iio.improps(path).shape
    except FileNotFoundError:
        raise NerfregError(f"{path}: image is missing") from None
    except Exception as error:
        raise NerfregError(f"{path}: cannot be read as an image: {_first_line(error)}") from None
    return ImageHeader(shape[1], shape[0], len(shape) == 3 and shape[2] in (2, 4))


def check_headers(paths: Sequence[Path]) -> ImageHeader:
    """The header that all these images share."""
    first = read_header(paths[0])
    for path in paths[1:]:
        header = read_header(path)
        if header[:2] != first[:2]:
            raise NerfregError(
                f"{path}: is {header.width} x {header.height} pixels, but {paths[0]} is "
                f"{first.width} x {first.height}; all images must have the same size"
            )
        if header.has_alpha != first.has_alpha:
            with_alpha, without = (path, paths[0]) if header.has_alpha else (paths[0], path)
            raise NerfregError(
                f"{without}: has no alpha channel, but {with_alpha} has; give all or none of them one"
            )
    return first


def read_image(path: Path, factor: int = 1) -> Float[Tensor, "height width channels"]:
    """An image in [0, 1], `factor` times smaller; three channels, or four with straight alpha."""
    try:
        pixels = iio.imread(path)
    except FileNotFoundError:
        raise NerfregError(f"{path}: image is missing") from None
    except Exception as error:
        raise NerfregError(f"{path}: cannot be read as an image: {_first_line(error)}") from None
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.shape[2] < 3:
        pixels = np.concatenate((np.repeat(pixels[:, :, :1], 3, axis=2), pixels[:, :, 1:]), axis=2)
    limit = np.iinfo(pixels.dtype).max if pixels.dtype.kind in "ui" else 1
    return reduce(torch.from_numpy(pixels.astype(np.float32) / np.float32(limit)), factor)


def reduce(
    image: Float[Tensor, "height width channels"], factor: int
) -> Float[Tensor, "rows columns channels"]:
    """Mean of `factor` x `factor` blocks; rows and columns that fill no block are dropped.

    Straight alpha weighs the colours, so that invisible pixels do not tint visible ones.
    """
    if factor == 1:
        return image
    height, width, channels = image.shape
    if factor < 1 or factor > min(height, width):
        raise NerfregError(
            f"scene.factor={factor}: must lie between 1 and the image size, {width} x {height}"
        )
    rows, columns = height // factor, width // factor
    blocks = image[: rows * factor, : columns * factor].reshape(
        rows, factor, columns, factor, channels
    )
    if channels == 3:
        return blocks.mean(dim=(1, 3))
    alpha = blocks[..., 3:]
    coverage = alpha.sum(dim=(1, 3))
    color = (blocks[..., :3] * alpha).sum(dim=(1, 3)) / coverage.clamp_min(1e-8)
    return torch.cat((color, coverage / factor**2), dim=-1)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
