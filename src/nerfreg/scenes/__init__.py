"""Scene formats: one configuration per format, which is also its loader."""

from __future__ import annotations

from nerfreg.scenes.base import SceneConfig
from nerfreg.scenes.blender import Blender
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.llff import LLFF
from nerfreg.scenes.procedural import Procedural
from nerfreg.scenes.scene import Scene
from nerfreg.scenes.transforms import Transforms

__all__ = [
    "LLFF",
    "SCENES",
    "Blender",
    "Cameras",
    "Procedural",
    "Scene",
    "SceneConfig",
    "Transforms",
    "load_scene",
]

SCENES: dict[str, type[SceneConfig]] = {
    "procedural": Procedural,
    "blender": Blender,
    "llff": LLFF,
    "transforms": Transforms,
}
"""The formats by the names that users choose them by (`scene=NAME`)."""


def load_scene(config: SceneConfig) -> Scene:
    """Load the scene that a configuration describes.

    Args:
        config: Format, files and split.

    Returns:
        The scene. Its images are read when they are asked for.

    Raises:
        NerfregError: If a file or a value of the configuration is wrong.
    """
    return config.load()
