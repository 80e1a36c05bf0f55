"""Write frames as a video."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.evaluation.images import to_uint8
from nerfreg.files import atomic


def write_video(
    path: Path, frames: Iterable[Float[Tensor, "height width 3"]], fps: int | float = 30
) -> None:
    """Write a video, as a whole or not at all.

    Args:
        path: A .gif file, which plays in an endless loop with delays in whole hundredths of a
            second, or an .mp4 file.
        frames: Colours in [0, 1].
        fps: Frames per second.

    Raises:
        NerfregError: If the suffix is another one, if there are no frames, if the file cannot be
            written, or if mp4 is asked for and imageio-ffmpeg is not installed.
    """
    # Frames are rendered as they are asked for, which takes long, so what can fail is checked
    # first.
    writers = {".gif": _write_gif, ".mp4": _write_mp4}
    writer = writers.get(path.suffix.lower())
    if writer is None:
        raise NerfregError(f"{path}: unknown video format {path.suffix!r}; use .gif or .mp4")
    if writer is _write_mp4 and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise NerfregError(
            f"{path}: mp4 needs imageio-ffmpeg; pip install nerfreg[video], or write a .gif"
        )
    with atomic(path) as part:
        count = writer(part, (to_uint8(frame) for frame in frames), fps)
        if count == 0:
            raise NerfregError(f"{path}: no frames to write")


def _write_gif(path: Path, frames: Iterable[np.ndarray], fps: int | float) -> int:
    import imageio.v3 as iio

    images = list(frames)
    # imageio fails on an empty list; the caller reports it.
    if images:
        iio.imwrite(path, images, plugin="pillow", duration=1000.0 / fps, loop=0)
    return len(images)


def _write_mp4(path: Path, frames: Iterable[np.ndarray], fps: int | float) -> int:
    from imageio.v2 import get_writer

    # One frame in memory at a time, since a video may be long.
    count = 0
    # With the default `macro_block_size` imageio would rescale frames whose sides are no multiples
    # of 16.
    video: Any = get_writer(
        path, format="FFMPEG", fps=fps, codec="libx264", quality=8, macro_block_size=1
    )
    with video:
        for frame in frames:
            video.append_data(_even_sides(frame))
            count += 1
    return count


def _even_sides(frame: np.ndarray) -> np.ndarray:
    """Repeat the last row or column where there is an odd number of them, as H.264 requires."""
    return np.pad(frame, ((0, frame.shape[0] % 2), (0, frame.shape[1] % 2), (0, 0)), mode="edge")
