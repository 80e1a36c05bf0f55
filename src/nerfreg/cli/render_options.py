"""What `nerfreg render RUN` can be told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from omegaconf import OmegaConf
from omegaconf.errors import ConfigKeyError, OmegaConfBaseException

from nerfreg.errors import NerfregError, nearest

CHOICES = {"path": ("test", "spiral", "orbit"), "format": ("mp4", "gif")}


@dataclass
class RenderOptions:
    """What is rendered, and where it goes.

    Attributes:
        path: "test" for the test views, or the camera path "spiral" or "orbit".
        frames: Frames of a video.
        fps: Frames per second.
        format: Of a video, "gif" or "mp4".
        out: Folder of the files; RUN/renders if None.
    """

    path: str = "test"
    frames: int = 60
    fps: float = 30.0
    format: str = "gif"
    out: str | None = None


def parse_render_options(words: Sequence[str]) -> RenderOptions:
    """Read `key=value` words.

    Raises:
        NerfregError: A word is not understood, naming key and value.
    """
    for word in words:
        if "=" not in word:
            raise NerfregError(f"'{word}' is no option of render; write key=value, e.g. path=orbit")
    try:
        options = OmegaConf.to_object(
            OmegaConf.merge(OmegaConf.structured(RenderOptions), OmegaConf.from_dotlist([*words]))
        )
    except ConfigKeyError as error:
        raise NerfregError(
            f"unknown option '{error.full_key}'; {nearest(str(error.key), vars(RenderOptions()))}"
        ) from error
    except OmegaConfBaseException as error:
        raise NerfregError(f"{error.full_key}: {str(error).partition(chr(10))[0]}") from error
    assert isinstance(options, RenderOptions)
    for key, choices in CHOICES.items():
        if getattr(options, key) not in choices:
            raise NerfregError(
                f"{key}={getattr(options, key)}: {nearest(getattr(options, key), choices)}"
            )
    if options.frames < 1 or options.fps <= 0:
        raise NerfregError(f"frames={options.frames} fps={options.fps}: both must be positive")
    return options
