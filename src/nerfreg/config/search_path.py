"""Where configuration files are found, and which choices each group has.

Four places are searched, and the first that has a file wins: the package's own `conf`, the user's
(`./conf`, then `$XDG_CONFIG_HOME/nerfreg`), and a folder `conf` beside a plugin's module.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.plugins.search_path_plugin import SearchPathPlugin

from nerfreg.config.folders import choices_on_disk, user_folders
from nerfreg.registry import PluginInfo

SCHEMA = "_schema"
"""Ending of the stored nodes that hold types. They are listed by files, and are no choices."""


def preset_folders(plugins: Sequence[PluginInfo]) -> list[Path]:
    """Return the folders `conf` that plugin packages ship beside their modules."""
    folders: dict[Path, None] = {}
    for plugin in plugins:
        module = sys.modules.get(plugin.cls.__module__) if plugin.cls else None
        package = sys.modules.get(module.__package__ or "") if module else None
        for path in getattr(package, "__path__", ()):
            folders[Path(path) / "conf"] = None
    return [folder for folder in folders if folder.is_dir()]


def options(group: str, plugins: Sequence[PluginInfo]) -> list[str]:
    """Return all choices of a configuration group."""
    folders = preset_folders(plugins)
    files = {path.stem for folder in folders for path in (folder / group).glob("*.yaml")}
    files |= choices_on_disk(group)
    try:
        stored = {name.removesuffix(".yaml") for name in ConfigStore.instance().list(group)}
    except OSError:  # Hydra's way of saying that there is no such group
        stored = set()
    return sorted(name for name in files | stored if not name.endswith(SCHEMA))


def register_search_path(plugins: Sequence[PluginInfo]) -> None:
    """Make Hydra search the user's folders and those of the plugins' packages."""
    Plugins.instance().register(_SearchPath)
    _SearchPath.plugins = plugins


class _SearchPath(SearchPathPlugin):
    # Hydra makes the instance itself, so that what it needs stands in the class.
    plugins: Sequence[PluginInfo] = ()

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        for folder in user_folders():
            search_path.append("nerfreg-user", f"file://{folder.resolve()}")
        for folder in preset_folders(self.plugins):
            search_path.append("nerfreg-plugins", f"file://{folder}")
