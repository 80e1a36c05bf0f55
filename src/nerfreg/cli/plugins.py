"""`nerfreg plugins`: what is installed."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.table import Table

from nerfreg.config.schema import register
from nerfreg.registry import PluginInfo

COLUMNS = ("name", "package", "version", "hook points", "summary", "state")


def print_plugins() -> None:
    """Print a table on a terminal; elsewhere one line a plugin, columns separated by tabs."""
    rows = [_row(plugin) for plugin in register()]
    if not sys.stdout.isatty():
        for row in (COLUMNS, *rows):
            print("\t".join(row))
        return
    table = Table(*COLUMNS, box=None, pad_edge=False)
    for row in rows:
        table.add_row(*row)
    Console(markup=False).print(table)


def _row(plugin: PluginInfo) -> tuple[str, ...]:
    hooks = ", ".join(plugin.hook_points)
    return plugin.address, plugin.package, plugin.version, hooks, plugin.summary, plugin.state
