"""From a composed configuration to dataclasses, checked once."""

from __future__ import annotations

import dataclasses
from copy import deepcopy

from omegaconf import DictConfig, OmegaConf

from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError, nearest
from nerfreg.hooks import Regularizer
from nerfreg.registry import Hooks
from nerfreg.scenes import SCENES, SceneConfig, load_scene


def validated(node: DictConfig) -> Config:
    """Return the composed configuration as dataclasses.

    Where nobody has named the layout, on which defaults may depend, it is found from the cameras.

    Raises:
        NerfregError: A part is not what its schema says, or two plugins cannot work together.
    """
    _refuse_unknown(node)
    scene = OmegaConf.to_object(node.scene) if OmegaConf.is_config(node.scene) else None
    if not isinstance(scene, SceneConfig) or node.scene.format not in SCENES:
        raise NerfregError(
            "scene: has no schema; begin the file's defaults list with e.g. `- llff_schema`"
        )
    _refuse_unselected(node)
    if scene.layout is None:
        node = deepcopy(node)
        node.scene.layout = load_scene(scene).layout
    config = OmegaConf.to_object(node)
    if not isinstance(config, Config):
        raise NerfregError(
            "the configuration has no schema; begin its defaults list with `- schema`"
        )
    Hooks(config.reg)  # refuses what cannot work together before anything is read
    return config


def _refuse_unknown(node: DictConfig, path: str = "") -> None:
    # `+key=value` can add keys that no dataclass has; they would change nothing, silently.
    schema = OmegaConf.get_type(node)
    known = (
        {field.name for field in dataclasses.fields(schema)}
        if dataclasses.is_dataclass(schema)
        else None
    )
    for key in map(str, node):
        if known is not None and key not in known:
            raise NerfregError(f"unknown key '{path}{key}'; {nearest(key, known)}")
        child = node._get_node(key)
        if isinstance(child, DictConfig) and not (child._is_none() or child._is_missing()):
            _refuse_unknown(child, f"{path}{key}.")


def _refuse_unselected(node: DictConfig) -> None:
    for name in node.reg:
        cls = OmegaConf.get_type(node.reg, str(name))
        if not (cls and issubclass(cls, Regularizer)):
            raise NerfregError(f"reg.{name}: not a selected plugin; select it by +reg={name}")
