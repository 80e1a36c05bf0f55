"""A plugin under check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from omegaconf import DictConfig, OmegaConf

from nerfreg.config.plugin import plugin_config
from nerfreg.hooks import Regularizer
from nerfreg.registry import Hooks, PluginInfo

AnyHooks = TypeVar("AnyHooks", bound=Hooks)


@dataclass(frozen=True)
class Subject:
    """A plugin under check, made anew each time so that no check inherits another's state.

    Attributes:
        name: Name of the plugin.
        hook_points: The hooks by which it takes part in a run.
        config: Its configuration.
        overrides: Those that made the configuration, as given on the command line.
    """

    name: str
    hook_points: tuple[str, ...]
    config: DictConfig
    overrides: tuple[str, ...] = ()

    @classmethod
    def of(cls, plugin: PluginInfo, overrides: Sequence[str] = ()) -> Subject:
        """Return a usable plugin with its defaults changed by overrides `reg.NAME.key=value`."""
        config = plugin_config(plugin, overrides)
        return cls(plugin.name, plugin.hook_points, config, tuple(overrides))

    def plugin(self) -> Regularizer:
        """Return the plugin as it is configured."""
        plugin = OmegaConf.to_object(self.config)
        assert isinstance(plugin, Regularizer)
        return plugin

    def hooks(
        self,
        kind: type[AnyHooks] = Hooks,  # type: ignore[assignment]  # the bound is its default
        weight: float = 1.0,
        start: int | float = 0.0,
        end: int | float = 1.0,
    ) -> AnyHooks:
        """Return the hooks of a run with this plugin alone.

        Args:
            kind: Class of the hooks.
            weight: The plugin's weight.
            start: Start of its window.
            end: End of its window.
        """
        plugin = self.plugin()
        plugin.weight, plugin.start, plugin.end = weight, start, end
        return kind({self.name: plugin})
