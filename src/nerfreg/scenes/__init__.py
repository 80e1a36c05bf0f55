"""Files to scenes: one configuration per format, which is also its loader."""

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


def load_scene(config: SceneConfig) -> Scene:
    """The scene that a configuration describes. Raises NerfregError for bad input."""
    return config.load()
