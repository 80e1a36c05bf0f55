"""What `+reg=` may name: plugins and presets, and plugins under another name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from hydra.core.config_store import ConfigNode, ConfigStore

from nerfreg.config.folders import choices_on_disk
from nerfreg.config.plugin_schema import field_choices, plugin_schema
from nerfreg.config.search_path import options
from nerfreg.registry import PluginInfo
from nerfreg.registry.plugins import find_plugin, why_not

GROUP = "reg"
ENDING = ".yaml"


def store_plugins(plugins: Sequence[PluginInfo]) -> list[PluginInfo]:
    """Tell Hydra the schemas of plugins, by name, and by "package:name" where that is needed.

    Returns:
        The plugins; one whose fields OmegaConf refuses is broken from now on.
    """
    store = ConfigStore.instance()
    choices = _Choices()
    # What others have stored in this group stays.
    choices.update(store.repo.get(GROUP, {}))
    store.repo[GROUP] = choices
    choices.plugins = [_stored(plugin, store) for plugin in plugins]
    return choices.plugins


def known_plugins() -> Sequence[PluginInfo]:
    """Return the plugins that Hydra has been told of."""
    choices = ConfigStore.instance().repo.get(GROUP)
    return choices.plugins if isinstance(choices, _Choices) else ()


def split_choice(choice: str) -> tuple[str, str]:
    """Return what a choice selects, and what the instance is called.

    Args:
        choice: "kl", "kl@mine", "package:kl" or "package:kl@mine".
    """
    address, _, alias = choice.partition("@")
    return address, alias or address.rpartition(":")[2]


def values_of(key: str, overrides: Sequence[str], plugins: Sequence[PluginInfo]) -> list[str]:
    """Return what `reg.NAME.KEY` may be, for shells; nothing where that is not a short list.

    Args:
        key: The key, without its value.
        overrides: Those before it, which may have given the instance its name.
        plugins: The installed plugins.
    """
    name, _, field = key.removeprefix("reg.").partition(".")
    listed = (override.partition("=")[2].strip("[]").split(",") for override in overrides)
    addresses = {
        split_choice(choice)[1]: choice.partition("@")[0] for own in listed for choice in own
    }
    plugin = find_plugin(addresses.get(name, name), plugins)
    return list(field_choices(plugin.cls, field)) if plugin and plugin.cls else []


def refusal(choice: str, plugins: Sequence[PluginInfo]) -> str:
    """Return why something cannot be selected, as far as plugins are concerned; else nothing."""
    address, at, alias = choice.partition("@")
    plugin = find_plugin(address, plugins)
    if plugin is None or plugin.cls is None:
        if at and address in choices_on_disk(GROUP):
            return f"'{address}' is a preset; only a plugin can have another name"
        return why_not(address, plugins)
    return alias_refusal(alias, plugins) if at else ""


def alias_refusal(alias: str, plugins: Sequence[PluginInfo]) -> str:
    """Return why an instance cannot have this name; nothing if it can."""
    if not alias.isidentifier():
        return f"'{alias}' after @ is no name; use letters, digits and _, as in @second"
    if alias in {plugin.name for plugin in plugins} | {*options(GROUP, plugins)}:
        return f"'{alias}' after @ is the name of a plugin or preset; choose another"
    return ""


class _Choices(dict[str, ConfigNode]):
    """The nodes of the group `reg`.

    Nodes under another name ("kl@mine") are made when Hydra asks for them, wherever they are named:
    on the command line, in a preset, or by a job of a sweep.
    """

    def __init__(self) -> None:
        super().__init__()
        self.plugins: list[PluginInfo] = []

    def __contains__(self, key: object) -> bool:
        return super().__contains__(key) or self._found(str(key)) is not None

    def __missing__(self, key: str) -> ConfigNode:
        plugin = self._found(key)
        if plugin is None:
            raise KeyError(key)
        made = _node(plugin, split_choice(key.removesuffix(ENDING))[1])
        return ConfigNode(name=key, group=GROUP, provider=None, **made)

    def _found(self, key: str) -> PluginInfo | None:
        choice = key.removesuffix(ENDING)
        plugin = find_plugin(choice.partition("@")[0], self.plugins)
        return None if refusal(choice, self.plugins) else plugin


def _stored(plugin: PluginInfo, store: ConfigStore) -> PluginInfo:
    if plugin.cls is None:
        return plugin
    try:
        store.store(group=GROUP, name=plugin.address, **_node(plugin, plugin.name))
    except Exception as exception:  # the annotations of a foreign package may be anything
        error = f"its fields are no configuration: {exception}".partition("\n")[0]
        return replace(plugin, cls=None, error=error)
    return plugin


def _node(plugin: PluginInfo, name: str) -> dict[str, Any]:
    assert plugin.cls is not None
    node = plugin_schema(plugin.address, plugin.cls)
    # Absolute, so that a preset of the group `reg` can list the plugin among its defaults.
    return {"node": node, "package": f"_global_.reg.{name}"}
