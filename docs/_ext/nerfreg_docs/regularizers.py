"""The index of the regularizers that nerfreg ships, and the tables of their options."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nerfreg_docs.fields import fields_table
from nerfreg_docs.markdown import plain, table

if TYPE_CHECKING:
    from nerfreg.registry import PluginInfo

PAGES = Path(__file__).parents[2] / "regularizers"


def own_plugins() -> list[PluginInfo]:
    """The regularizers of this repository, in the order of their names.

    Raises:
        RuntimeError: One of them cannot be imported.
    """
    from nerfreg.registry import installed

    plugins = [plugin for plugin in installed() if plugin.package == "nerfreg"]
    for plugin in plugins:
        if plugin.cls is None:
            raise RuntimeError(f"{plugin.name}: {plugin.error}")
    return plugins


def plugin_table(plugin: PluginInfo) -> str:
    """The options of a regularizer, the inherited ones included."""
    assert plugin.cls is not None
    return fields_table(f"reg.{plugin.name}.", plugin.cls, by_layout=plugin.cls.by_layout)


def regularizers() -> str:
    """An index with a link to the page of each regularizer, and its options."""
    plugins = own_plugins()
    rows = [
        [f"[{plugin.name}](#{plugin.name})", plain(plugin.summary), ", ".join(plugin.hook_points)]
        for plugin in plugins
    ]
    parts = [table(["`+reg=`", "what it does", "hooks"], rows)]
    for plugin in plugins:
        page = PAGES / f"{plugin.name}.md"
        link = f"[Definition, edge cases and source](../regularizers/{page.name})"
        parts += [f"## {plugin.name}", plain(plugin.summary), link, plugin_table(plugin)]
    pages = "\n".join(f"../regularizers/{plugin.name}" for plugin in plugins)
    return "\n\n".join([*parts, f"```{{toctree}}\n:hidden:\n\n{pages}\n```"])
