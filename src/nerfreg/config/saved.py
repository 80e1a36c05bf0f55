"""The configuration of a finished run, read back from its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from nerfreg.config.explain import COMPOSITION_ERRORS, explain
from nerfreg.config.schema import Config, plugin_schema, register, scene_schema
from nerfreg.config.validation import validated
from nerfreg.errors import NerfregError


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
    classes = {plugin.name: plugin.cls for plugin in plugins}
    try:
        schema: DictConfig = OmegaConf.structured(Config)
        schema.scene = scene_schema(str(OmegaConf.select(saved, "scene.format")))
        for name in OmegaConf.select(saved, "reg", default={}):
            cls = classes.get(name)
            if cls is None:
                raise NerfregError(
                    f"{source}: reg.{name} is not installed here; see `nerfreg plugins`"
                )
            schema.reg[name] = plugin_schema(name, cls)
        known = OmegaConf.merge(schema, saved)
        OmegaConf.set_struct(known, True)
        merged = OmegaConf.merge(known, OmegaConf.from_dotlist([*overrides]))
        assert isinstance(merged, DictConfig)
        return validated(merged)
    except (*COMPOSITION_ERRORS, KeyError) as error:
        raise NerfregError(f"{source}: {explain(error, plugins)}") from error
