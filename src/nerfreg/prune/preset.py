"""The smaller set as a preset in the user's configuration folder."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from omegaconf import OmegaConf

from nerfreg.config.schema import Config
from nerfreg.config.search_path import options
from nerfreg.errors import NerfregError
from nerfreg.files import write_text
from nerfreg.hooks import Regularizer
from nerfreg.prune.plan import Selection
from nerfreg.registry import installed

MARK = "# What `nerfreg prune` leaves"
"""How the file begins; another file of the same name is somebody's own, and stays."""


def preset_name(scene: str) -> str:
    """What a scene's preset is called unless the user says otherwise."""
    return f"pruned_{plain(scene)}"


def plain(text: str) -> str:
    """A name without anything that a command line could read otherwise."""
    return re.sub(r"\W+", "_", text).strip("_")


def preset_path(name: str) -> Path:
    """Where the preset goes: ./conf/reg, which `+reg=` looks through.

    Raises NerfregError for a name that is not one, or is somebody else's.
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
    """A preset that selects `kept`, with the settings in which the configuration differs from their defaults."""
    settings = {name: changed for name in kept if (changed := changed_settings(config, name))}
    content: dict[str, Any] = {"defaults": [*kept, "_self_"]}
    body = yaml.safe_dump(content, default_flow_style=None, sort_keys=False, width=120)
    if settings:
        body += yaml.safe_dump(settings, default_flow_style=False, sort_keys=False)
    lines = [f"# {line}".rstrip() for line in comments]
    lines[0] = f"{MARK} {comments[0]}"
    write_text(path, "\n".join(lines) + "\n" + body)


def changed_settings(config: Config, name: str) -> dict[str, Any]:
    """Fields of a selected plugin that are not its defaults for the layout of the scene."""
    plugin: Regularizer = config.reg[name]
    cls = type(plugin)
    defaults = _fields(cls(**cls.by_layout.get(config.scene.layout or "", {})))
    return {
        key: value
        for key, value in _fields(plugin).items()
        if value != defaults[key] or type(value) is not type(defaults[key])
    }


def _fields(plugin: Regularizer) -> dict[str, Any]:
    fields = OmegaConf.to_container(OmegaConf.structured(plugin), enum_to_str=True)
    assert isinstance(fields, dict)
    return {str(key): value for key, value in fields.items()}
