"""A plugin under check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from nerfreg.errors import NerfregError, nearest
from nerfreg.hooks import Regularizer
from nerfreg.registry import Hooks, PluginInfo


@dataclass(frozen=True)
class Subject:
    """Makes the plugin anew for every check, so that none inherits what another left behind.

    node: its configuration. overrides: as given on the command line.
    """

    name: str
    hook_points: tuple[str, ...]
    node: DictConfig
    overrides: tuple[str, ...] = ()

    def hooks(self) -> Hooks:
        """The hooks of a run with this plugin alone, switched on all the time."""
        return Hooks({self.name: self.plugin()})

    def plugin(self) -> Regularizer:
        """The plugin as configured, but for its weight and window."""
        plugin = OmegaConf.to_object(self.node)
        assert isinstance(plugin, Regularizer)
        plugin.weight, plugin.start, plugin.end = 1.0, 0.0, 1.0
        return plugin


def make_subject(plugin: PluginInfo, overrides: Sequence[str] = ()) -> Subject:
    """A usable plugin with its own defaults, changed by overrides `reg.NAME.key=value`.

    Raises NerfregError where the plugin's configuration refuses them.
    """
    assert plugin.cls is not None
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
    return Subject(plugin.name, plugin.hook_points, node, tuple(overrides))
