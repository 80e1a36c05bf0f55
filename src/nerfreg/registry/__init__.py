"""From entry points to plugins, and from the selected plugins to the hooks of one run."""

from nerfreg.registry.hooks import Hooks, Term
from nerfreg.registry.plugins import PluginInfo, installed

__all__ = ["Hooks", "PluginInfo", "Term", "installed"]
