"""The names of a new plugin and its package, and what a name must not be."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from importlib.util import find_spec

import nerfreg
from nerfreg.config.folders import choices_on_disk
from nerfreg.errors import NerfregError
from nerfreg.registry import installed

PATTERN = r"[a-z][a-z0-9]*([_-][a-z0-9]+)*"
VALUES = ("null", "none", "true", "false", "inf", "nan")
"""Words that the configuration reads as values."""

RESERVED = ("compositing",)
"""What `nerfreg check` calls the core's own part."""

USED = ("Frequencies", "BiasedLinear", "Any", "ClassVar", *nerfreg.__all__)
"""Names in the module of the plugin that are no name for its class."""


@dataclass(frozen=True)
class PluginNames:
    """What a plugin and its package are called.

    Attributes:
        plugin: By which it is selected, such as `my_plugin`.
    """

    plugin: str

    @property
    def distribution(self) -> str:
        """The package to install, such as `nerfreg-my-plugin`."""
        return f"nerfreg-{self.plugin.replace('_', '-')}"

    @property
    def module(self) -> str:
        """The package to import, such as `nerfreg_my_plugin`."""
        return f"nerfreg_{self.plugin}"

    @property
    def cls(self) -> str:
        """The class, such as `MyPlugin`."""
        name = "".join(part.capitalize() for part in self.plugin.split("_"))
        return f"{name}Regularizer" if name in USED else name


def plugin_names(word: str) -> PluginNames:
    """Return the names of a new plugin; hyphens count as underscores.

    Raises:
        NerfregError: The word is no name, or something that is installed has it.
    """
    if not re.fullmatch(PATTERN, word):
        raise NerfregError(
            f"'{word}' is no name for a plugin; use lower-case letters and digits, "
            "separated by underscores, as in depth_ranking"
        )
    names = PluginNames(word.replace("-", "_"))
    _refuse(word, names.plugin in VALUES, "is a value in configurations; choose another name")
    _refuse(word, names.plugin in RESERVED, "is a part of nerfreg; choose another name")
    plugins = {plugin.name: plugin.package for plugin in installed()}
    owner = plugins.get(names.plugin)
    _refuse(word, owner is not None, f"is a plugin of {owner} already; choose another name")
    presets: Collection[str] = choices_on_disk("reg")
    _refuse(word, names.plugin in presets, "is a preset already; choose another name")
    taken = find_spec(names.module) is not None
    _refuse(word, taken, f"needs a module {names.module}, which is installed; choose another name")
    return names


def _refuse(word: str, wrong: bool, reason: str) -> None:
    if wrong:
        raise NerfregError(f"'{word}' {reason}")
