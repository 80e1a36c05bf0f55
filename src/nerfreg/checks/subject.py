"""A plugin under check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from omegaconf import DictConfig, OmegaConf

from nerfreg.config.plugin import plugin_config
from nerfreg.hooks import Regularizer
from nerfreg.registry import Hooks, PluginInfo


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

    @classmethod
    def none(cls) -> Subject:
        """Return a subject that is no plugin."""
        return cls("", (), OmegaConf.create())

    def hooks(self) -> Hooks:
        """Return the hooks of a run with this plugin alone, of weight 1 and on all the time."""
        return Hooks(self.selected())

    def configured(self) -> Regularizer:
        """Return the plugin as it is configured."""
        plugin = OmegaConf.to_object(self.config)
        assert isinstance(plugin, Regularizer)
        return plugin

    def selected(
        self, start: int | float = 0.0, end: int | float = 1.0, weight: float = 1.0
    ) -> dict[str, Regularizer]:
        """Return the plugin by its name, as a run has it, with another window and weight.

        Args:
            start: Start of the window.
            end: End of the window.
            weight: The weight.
        """
        plugin = self.configured()
        plugin.weight, plugin.start, plugin.end = weight, start, end
        return {self.name: plugin}
