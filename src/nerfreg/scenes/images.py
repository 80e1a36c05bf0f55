"""Image files: find them, check their headers, read them as float tensors, reduce their size."""

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
    """What the header of an image file says.

    Attributes:
        width: Width in pixels.
        height: Height in pixels.
        has_alpha: Whether there is an alpha channel.
    """

    width: int
    height: int
    has_alpha: bool


def find_image(path: Path) -> Path:
    """Find the file of a path whose extension may be missing.

    Args:
        path: The path, as a JSON file names it.

    Returns:
        The file, or `path` itself if there is none: whoever reads it reports it as missing.
    """
    if path.is_file():
        return path
    # Appended and not replaced: a dot in "r_0.5" does not begin an extension.
    candidates = (path.with_name(path.name + extension) for extension in EXTENSIONS)
    return next((candidate for candidate in candidates if candidate.is_file()), path)


def list_images(folder: Path) -> list[Path]:
    """List the images of a folder, sorted by name."""
    # Hidden files are left out: macOS puts "._IMG.JPG" beside images on foreign file systems.
    return sorted(
        path
        for path in folder.iterdir()
        if path.suffix in EXTENSIONS and not path.name.startswith(".")
    )


def read_header(path: Path) -> ImageHeader:
    """Read size and channels of an image, without decoding it.

    Args:
        path: The file.

    Returns:
        What the header says.

    Raises:
        NerfregError: If the file is missing or not an image.
    """
    try:
        shape = iio.improps(path).shape
    except FileNotFoundError:
        raise NerfregError(f"{path}: image is missing") from None
    except Exception as error:  # imageio's plugins raise whatever their libraries raise
        raise NerfregError(f"{path}: cannot be read as an image: {_first_line(error)}") from None
    # Two channels are grey and alpha.
    return ImageHeader(shape[1], shape[0], len(shape) == 3 and shape[2] in (2, 4))


def check_headers(paths: Sequence[Path]) -> ImageHeader:
    """Check that images agree in size and in having alpha.

    Args:
        paths: The files.

    Returns:
        The header that they share.

    Raises:
        NerfregError: If one is missing, is not an image, or differs from the first.
    """
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
                f"{without}: has no alpha channel, but {with_alpha} has one; "
                "all images or none must have one"
            )
    return first


def check_factor(factor: int, width: int, height: int) -> None:
    """Raise NerfregError if images of this size cannot be made `factor` times smaller."""
    if not 1 <= factor <= min(width, height):
        raise NerfregError(
            f"scene.factor={factor}: must lie between 1 and the image size, {width} x {height}"
        )


def read_image(path: Path, factor: int = 1) -> Float[Tensor, "height width channels"]:
    """Read an image.

    Args:
        path: The file.
        factor: How many times smaller to make it.

    Returns:
        The image in [0, 1]: three channels, or four with straight (not premultiplied) alpha.

    Raises:
        NerfregError: If the file is missing or not an image.
    """
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
    # Float images are in [0, 1] already; integers of 8 and 16 bits are not.
    limit = np.iinfo(pixels.dtype).max if pixels.dtype.kind in "ui" else 1
    return reduce(torch.from_numpy(pixels.astype(np.float32) / np.float32(limit)), factor)


def reduce(
    image: Float[Tensor, "height width channels"], factor: int
) -> Float[Tensor, "rows columns channels"]:
    """Reduce an image by taking the mean of blocks of pixels.

    Args:
        image: The image; a fourth channel is straight alpha, which weights the colours, so that
            invisible pixels do not tint visible ones.
        factor: Side of a block in pixels. Rows and columns that fill no block are dropped.

    Returns:
        The reduced image.

    Raises:
        NerfregError: If the image is smaller than a block.
    """
    if factor == 1:
        return image
    height, width, channels = image.shape
    check_factor(factor, width, height)
    rows, columns = height // factor, width // factor
    blocks = image[: rows * factor, : columns * factor].reshape(
        rows, factor, columns, factor, channels
    )
    if channels == 3:
        return blocks.mean(dim=(1, 3))
    alpha = blocks[..., 3:]
    coverage = alpha.sum(dim=(1, 3))
    # A block without any coverage becomes black instead of 0 / 0; its colour is invisible.
    color = (blocks[..., :3] * alpha).sum(dim=(1, 3)) / coverage.clamp_min(1e-8)
    return torch.cat((color, coverage / factor**2), dim=-1)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
