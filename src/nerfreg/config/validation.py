"""From a composed configuration to dataclasses, checked once."""

from __future__ import annotations

import dataclasses
from copy import deepcopy

from omegaconf import DictConfig, OmegaConf

from nerfreg.config.plugin import make_plugin
from nerfreg.config.plugin_store import alias_refusal, known_plugins, split_choice
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError, nearest
from nerfreg.hooks import Regularizer
from nerfreg.registry import Hooks
from nerfreg.registry.plugin_fields import PLUGIN_KEY
from nerfreg.registry.plugins import find_plugin
from nerfreg.scenes import SCENES, SceneConfig, load_scene
from nerfreg.scenes.layouts import ORBIT


def validated(node: DictConfig) -> Config:
    """Return the composed configuration as dataclasses.

    Where nobody has named the kind of capture, on which defaults may depend, it is found from
    cameras and images, and `scene.layout` of what is returned holds it.

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
    node = deepcopy(node)
    found = scene.layout in (None, ORBIT)
    if found:
        loaded = load_scene(scene)
        node.scene.layout, found = loaded.layout, loaded.layout_found
    plugins = {str(name): make_plugin(str(name), node.reg[name]) for name in node.reg}
    node.reg = {}
    config = OmegaConf.to_object(node)
    if not isinstance(config, Config):
        raise NerfregError(
            "the configuration has no schema; begin its defaults list with `- schema`"
        )
    config.reg = plugins
    # On the instance, since it is no key.
    vars(config.scene)["layout_found"] = found
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
    if known is not None and schema is not None and issubclass(schema, Regularizer):
        known |= {PLUGIN_KEY}
    for key in map(str, node):
        if known is not None and key not in known:
            raise NerfregError(f"unknown key '{path}{key}'; {nearest(key, known)}")
        child = node._get_node(key)
        if isinstance(child, DictConfig) and not (child._is_none() or child._is_missing()):
            _refuse_unknown(child, f"{path}{key}.")


def _refuse_unselected(node: DictConfig) -> None:
    plugins = known_plugins()
    for name in map(str, node.reg):
        cls = OmegaConf.get_type(node.reg, name)
        if not (cls and issubclass(cls, Regularizer)):
            raise NerfregError(f"reg.{name}: not a selected plugin; select it by +reg={name}")
        address = str(node.reg[name][PLUGIN_KEY])
        plugin = find_plugin(address, plugins)
        if plugin is not None and plugin.cls is not cls:
            raise NerfregError(
                f"reg.{name}.{PLUGIN_KEY}={address}: cannot be changed; "
                f"select it by +reg={address}@{name}"
            )
        # A preset may name an instance without asking (`- kl@mine` is Hydra's own).
        if name != split_choice(address)[1] and (why := alias_refusal(name, plugins)):
            raise NerfregError(f"+reg={address}@{name}: {why}")
