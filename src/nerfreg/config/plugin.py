"""Plugins and their configurations: from a node to an instance with schedules, and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from nerfreg.config.plugin_schema import typed_node
from nerfreg.errors import NerfregError, nearest
from nerfreg.hooks import Regularizer, Schedule
from nerfreg.registry import PluginInfo
from nerfreg.registry.plugin_fields import PLUGIN_KEY, schedulable_fields
from nerfreg.registry.plugins import ADDRESS, plugin_name


def plugin_config(plugin: PluginInfo, overrides: Sequence[str] = ()) -> DictConfig:
    """Return the defaults of a usable plugin, changed by overrides `reg.NAME.key=value`.

    Raises:
        NerfregError: The plugin refuses an override, by its keys, types or values.
    """
    assert plugin.cls is not None
    try:
        node = typed_node(plugin.address, plugin.cls)
        for override in overrides:
            path, _, value = override.partition("=")
            key = path.rpartition(".")[2]
            if key not in node or key == PLUGIN_KEY:
                known = (name for name in map(str, node) if name != PLUGIN_KEY)
                raise NerfregError(f"unknown key '{path}'; {nearest(key, known)}")
            OmegaConf.update(node, key, parsed(value))
        make_plugin(plugin.name, node)
    except OmegaConfBaseException as error:
        raise NerfregError(f"reg.{plugin.name}: {error}".partition("\n")[0]) from error
    return node


def parsed(text: str) -> Any:
    """Return the value of an override; mappings and lists as Hydra reads them, the rest as YAML."""
    if text.startswith(("{", "[")):
        try:
            return OverridesParser.create().parse_override(f"key={text}").value()
        except OverrideParseException:
            # It may still be YAML, which quotes otherwise.
            pass
    return OmegaConf.from_dotlist([f"key={text}"])["key"]


def make_plugin(name: str, node: DictConfig) -> Regularizer:
    """Return the instance that a configuration describes.

    Where a field has a schedule, the instance has the value with which it begins, and
    `Regularizer.schedules` the rest.

    Args:
        name: What the instance is called.
        node: Its configuration, which may be a part of a larger one that it refers to.

    Raises:
        NerfregError: The plugin refuses a value, be it one that a schedule comes to.
    """
    cls = OmegaConf.get_type(node)
    assert cls is not None and issubclass(cls, Regularizer)
    address = str(node[PLUGIN_KEY])
    schedules = {
        key: schedule
        for key in schedulable_fields(cls)
        if (schedule := _schedule(f"reg.{name}.{key}", node, key))
    }
    # A copy of a node still knows the configuration around it, which interpolations need.
    plain = deepcopy(node)
    del plain.__dict__["_content"][PLUGIN_KEY]
    for key, schedule in schedules.items():
        plain[key] = schedule.at(0.0)
    made = _constructed(name, address, lambda: OmegaConf.to_object(plain))
    for key, schedule in schedules.items():
        for value in schedule.values:
            _constructed(name, address, partial(dataclasses.replace, made, **{key: value}))
    # On the instance, since neither is a field.
    vars(made).update({"schedules": schedules, ADDRESS: address})
    return made


def settings_of(plugin: Regularizer) -> dict[str, Any]:
    """Return the configuration of an instance, with schedules as they are written."""
    values = dataclasses.asdict(plugin)
    return values | {key: schedule.written() for key, schedule in plugin.schedules.items()}


def saved_settings(name: str, plugin: Regularizer) -> dict[str, Any]:
    """Return the same in plain types, with the key by which `restored` finds the plugin."""
    return {PLUGIN_KEY: plugin_name(name, plugin), **_in_yaml(settings_of(plugin))}


def _schedule(where: str, node: DictConfig, key: str) -> Schedule | None:
    value = node[key]
    if not isinstance(value, Mapping):
        return None
    # Only here, where the whole configuration is known, can what it refers to be put in.
    mapping = OmegaConf.create(dict(value), parent=node)
    plain: Any = OmegaConf.to_container(mapping, resolve=True)
    try:
        schedule = Schedule.read(plain)
    except NerfregError as error:
        raise NerfregError(f"{where}: {error}") from error
    if key == "weight" and min(schedule.values) < 0:
        raise NerfregError(
            f"{where}: a schedule that comes to {min(schedule.values):g}; must not be negative"
        )
    return schedule


def _constructed(name: str, address: str, make: Callable[[], Any]) -> Regularizer:
    try:
        made = make()
    except OmegaConfBaseException:
        raise
    except NerfregError as error:
        # A plugin calls itself by its own name, whatever the name of this instance.
        own = f"reg.{address.rpartition(':')[2]}."
        raise NerfregError(str(error).replace(own, f"reg.{name}.")) from error
    except Exception as error:  # the __post_init__ of a foreign package may raise anything
        reason = f"{type(error).__name__}: {error}".partition("\n")[0]
        raise NerfregError(f"reg.{name}: {reason}") from error
    assert isinstance(made, Regularizer)
    return made


def _in_yaml(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, dict):
        return {key: _in_yaml(item) for key, item in value.items()}
    return [_in_yaml(item) for item in value] if isinstance(value, list) else value
