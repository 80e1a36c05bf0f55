"""All configuration keys, from the dataclasses that define them."""

from __future__ import annotations

import dataclasses
from typing import Any

from nerfreg_docs import presets
from nerfreg_docs.docstrings import summary
from nerfreg_docs.fields import fields_table, yaml_value
from nerfreg_docs.markdown import code, plain
from nerfreg_docs.regularizers import own_plugins, plugin_table

FOLDER_GROUPS = {"reg": "Presets of regularizers", "experiment": "Experiments"}


def configuration() -> str:
    """Top-level keys, groups, scene formats, regularizers and presets as Markdown."""
    from nerfreg.config.schema import Config
    from nerfreg.scenes import SCENES

    config = Config()
    groups = {
        field.name: type(getattr(config, field.name))
        for field in dataclasses.fields(Config)
        if dataclasses.is_dataclass(getattr(config, field.name))
    }
    top = frozenset(field.name for field in dataclasses.fields(Config)) - groups.keys()
    parts = ["## Top level", fields_table("", Config, only=top - {"scene", "reg"})]
    for name, cls in groups.items():
        parts += _group(name, cls)
    parts += ["## `scene`", presets.choices_table("scene"), *_shared_scene_keys()]
    for name in SCENES:
        parts += _scene(name)
    parts.append("## `reg`")
    for plugin in own_plugins():
        parts += [f"### `reg.{plugin.name}`", plain(plugin.summary), plugin_table(plugin)]
    for group, title in FOLDER_GROUPS.items():
        parts += [f"## {title}", presets.choices_table(group)]
    return "\n\n".join(parts)


def _group(name: str, cls: type) -> list[str]:
    values: dict[str, Any] = {}
    choices = ""
    if (presets.CONF / name).is_dir():
        values = presets.read(name, presets.chosen(name))
        choices = presets.choices_table(name)
    values, by_layout = _split_by_layout(values)
    table = fields_table(f"{name}.", cls, values, by_layout)
    return [f"## `{name}`", plain(summary(cls)), table, choices]


def _split_by_layout(
    values: dict[str, Any],
) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Take values such as `${by_layout:FORWARD,ORBIT}` apart; that of objects is the plain one."""
    from nerfreg.config.schema import VALUES

    plain_values: dict[str, Any] = {}
    by_layout: dict[str, dict[str, Any]] = {"forward": {}, "room": {}}
    for key, value in values.items():
        if isinstance(value, str) and value.startswith("${by_layout:"):
            given = value.removeprefix("${by_layout:").removesuffix("}").split(",")
            named = dict(zip(VALUES[len(given)], given, strict=True))
            plain_values[key] = named.get("object", named.get("orbit"))
            for layout, defaults in by_layout.items():
                if layout in named:
                    defaults[key] = named[layout]
        else:
            plain_values[key] = value
    return plain_values, by_layout


def _shared_scene_keys() -> list[str]:
    from nerfreg.scenes import SceneConfig

    return ["### Keys of all formats", fields_table("scene.", SceneConfig)]


def _scene(name: str) -> list[str]:
    """The keys that a format adds, and those whose default it changes."""
    from nerfreg.scenes import SCENES, SceneConfig

    cls, content = SCENES[name], presets.read("scene", name)
    values = content.get("scene", content)
    others = {group: keys for group, keys in content.items() if isinstance(keys, dict)}
    shared = {field.name: field.default for field in dataclasses.fields(SceneConfig)}
    changed = frozenset(
        field.name
        for field in dataclasses.fields(cls)
        if field.name not in shared or values.get(field.name, field.default) != shared[field.name]
    )
    parts = [f"### `scene={name}`", plain(summary(cls))]
    parts.append(fields_table("scene.", cls, values, only=changed))
    for group, keys in others.items():
        if group != "scene":
            settings = ", ".join(code(f"{group}.{k}={yaml_value(v)}") for k, v in keys.items())
            parts.append(f"Selecting this format also sets {settings}.")
    return parts
