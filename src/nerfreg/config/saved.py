"""The configuration of a finished run, read back from its folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from nerfreg.config.explain import COMPOSITION_ERRORS, explain
from nerfreg.config.plugin import parsed, saved_settings
from nerfreg.config.plugin_schema import plugin_schema
from nerfreg.config.schema import Config, register, scene_schema
from nerfreg.config.validation import validated
from nerfreg.errors import NerfregError
from nerfreg.registry.plugin_fields import PLUGIN_KEY
from nerfreg.registry.plugins import find_plugin


def read_run(folder: Path, overrides: Sequence[str] = ()) -> Config:
    """Return RUN/.hydra/config.yaml with its types.

    Args:
        folder: The run's folder.
        overrides: `key=value` changes.

    Raises:
        NerfregError: There is no run, or its plugins are not installed.
    """
    path = folder / ".hydra" / "config.yaml"
    if not path.is_file():
        raise NerfregError(f"{folder}: not the folder of a run (no .hydra/config.yaml in it)")
    try:
        saved = OmegaConf.load(path)
    except COMPOSITION_ERRORS as error:
        raise NerfregError(f"{path}: {explain(error, ())}") from error
    return restored(saved, str(path), overrides)


def as_yaml(config: Config) -> str:
    """Return a configuration as text from which `restored` makes it again."""
    saved = OmegaConf.structured(replace(config, reg={}))
    saved.reg = {name: saved_settings(name, plugin) for name, plugin in config.reg.items()}
    return OmegaConf.to_yaml(saved)


def restored(saved: Any, source: str, overrides: Sequence[str] = ()) -> Config:
    """Return a saved configuration with its types.

    Args:
        saved: The configuration as it was read.
        source: The file it comes from, for messages.
        overrides: `key=value` changes.

    Raises:
        NerfregError: Its plugins are not installed, or an override cannot be used.
    """
    for override in overrides:
        if "=" not in override:
            raise NerfregError(f"'{override}' is not an override; write key=value")
    plugins = register()
    try:
        schema: DictConfig = OmegaConf.structured(Config)
        schema.scene = scene_schema(str(OmegaConf.select(saved, "scene.format")))
        for name in OmegaConf.select(saved, "reg", default={}):
            # Runs of earlier versions do not say which plugin it is.
            address = OmegaConf.select(saved.reg[name], PLUGIN_KEY, default=name)
            plugin = find_plugin(address, plugins)
            if plugin is None or plugin.cls is None:
                which = name if name == address else f"{name} (plugin {address})"
                raise NerfregError(
                    f"{source}: reg.{which} is not installed here; see `nerfreg plugins`"
                )
            schema.reg[name] = plugin_schema(address, plugin.cls)
        known = OmegaConf.merge(schema, saved)
        OmegaConf.set_struct(known, True)
        for override in overrides:
            key, _, value = override.partition("=")
            OmegaConf.update(known, key, parsed(value))
        assert isinstance(known, DictConfig)
        return validated(known)
    except (*COMPOSITION_ERRORS, KeyError) as error:
        raise NerfregError(f"{source}: {explain(error, plugins)}") from error
