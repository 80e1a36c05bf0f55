"""From entry points to plugins, and from the selected plugins to the hooks of one run."""

from nerfreg.registry.hooks import Hooks
from nerfreg.registry.plugins import PluginInfo, installed
from nerfreg.registry.stepping import Term

__all__ = ["Hooks", "PluginInfo", "Term", "installed"]
