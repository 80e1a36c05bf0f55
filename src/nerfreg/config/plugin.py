"""The configuration of one plugin by itself, for tools that need no run around it."""

from __future__ import annotations

from collections.abc import Sequence

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from nerfreg.errors import NerfregError, nearest
from nerfreg.registry import PluginInfo


def plugin_config(plugin: PluginInfo, overrides: Sequence[str] = ()) -> DictConfig:
    """Return the defaults of a usable plugin, changed by overrides `reg.NAME.key=value`.

    Raises:
        NerfregError: The plugin refuses an override, by its keys, types or values.
    """
    try:
        node: DictConfig = OmegaConf.structured(plugin.cls)
        for override in overrides:
            path, _, value = override.partition("=")
            key = path.removeprefix(f"reg.{plugin.name}.")
            if key not in node:
                raise NerfregError(f"unknown key '{path}'; {nearest(key, map(str, node))}")
            node.merge_with_dotlist([f"{key}={value}"])
        OmegaConf.to_object(node)
    except OmegaConfBaseException as error:
        raise NerfregError(f"reg.{plugin.name}: {error}".partition("\n")[0]) from error
    return node
