"""The smaller set as a preset in the user's configuration folder."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from nerfreg.config.plugin import saved_settings
from nerfreg.config.plugin_store import split_choice
from nerfreg.config.schema import Config
from nerfreg.config.search_path import options
from nerfreg.errors import NerfregError
from nerfreg.files import write_text
from nerfreg.prune.plan import Selection
from nerfreg.registry import installed
from nerfreg.registry.plugin_fields import PLUGIN_KEY
from nerfreg.registry.plugins import plugin_name
from nerfreg.scenes.layouts import defaults_of

MARK = "# What `nerfreg prune` leaves"
"""How the file begins; one that begins otherwise is the user's own and is not overwritten."""


def plain(text: str) -> str:
    """Replace whatever a command line could read otherwise."""
    return re.sub(r"\W+", "_", text).strip("_")


def preset_path(name: str) -> Path:
    """Return the file of a preset in ./conf/reg, where `+reg=` finds it.

    Raises:
        NerfregError: The name is not a name, or belongs to something else.
    """
    if not re.fullmatch(r"\w[\w-]*", name):
        raise NerfregError(
            f"--name {name}: use letters, digits, _ and - only, so that +reg={name} can be written"
        )
    path = Path("conf", "reg", f"{name}.yaml")
    if path.is_file():
        if not path.read_text(encoding="utf-8").startswith(MARK):
            raise NerfregError(
                f"{path}: exists, and nerfreg prune did not write it; choose another --name"
            )
    elif name in options("reg", installed()):
        raise NerfregError(
            f"--name {name}: a plugin or preset of this name exists already; choose another"
        )
    return path


def write_preset(path: Path, config: Config, kept: Selection, comments: Sequence[str]) -> None:
    """Write a preset that selects `kept` with the settings that are not their defaults."""
    plugins = {name: plugin_name(name, config.reg[name]) for name in kept}
    choices = [
        plugin if split_choice(plugin)[1] == name else f"{plugin}@{name}"
        for name, plugin in plugins.items()
    ]
    content: dict[str, Any] = {"defaults": [*choices, "_self_"]}
    body = yaml.safe_dump(content, default_flow_style=None, sort_keys=False, width=120)
    settings = {name: changed for name in kept if (changed := changed_settings(config, name))}
    if settings:
        body += yaml.safe_dump(settings, default_flow_style=False, sort_keys=False)
    write_text(path, f"{MARK} " + "\n# ".join(comments) + "\n" + body)


def changed_settings(config: Config, name: str) -> dict[str, Any]:
    """Return the fields of a plugin that differ from its defaults for the kind of capture."""
    cls = type(config.reg[name])
    plugins = config.reg[name], cls(**defaults_of(config.scene.layout, cls.by_layout))
    own, defaults = (saved_settings(name, plugin) for plugin in plugins)
    # Which plugin it is stands among the defaults of the preset.
    del own[PLUGIN_KEY]
    # Steps and shares of the budget differ by their type alone: 1 is not 1.0.
    return {
        str(key): value
        for key, value in own.items()
        if value != defaults[key] or type(value) is not type(defaults[key])
    }
