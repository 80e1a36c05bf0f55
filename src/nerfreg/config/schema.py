"""The types of all configuration keys: every key is known and checked before a run starts.

The schema is made of the dataclasses of the packages (field, sampler, ...), of the scene formats
and of the installed plugins.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from nerfreg.config.naming import run_name
from nerfreg.config.plugin_store import store_plugins
from nerfreg.config.search_path import SCHEMA, register_search_path
from nerfreg.errors import NerfregError
from nerfreg.evaluation.config import EvalConfig
from nerfreg.field.config import FieldConfig
from nerfreg.registry import PluginInfo, installed
from nerfreg.rendering.config import SamplerConfig
from nerfreg.scenes import SCENES
from nerfreg.scenes.layouts import FORWARD, KINDS, ORBIT, defaults_of
from nerfreg.training.config import OptimConfig, TrainConfig

VALUES = {2: (FORWARD, ORBIT), 3: tuple(KINDS)}
"""For which kinds of capture the values of `${by_layout:...}` stand, by their number."""


@dataclass
class Config:
    """Everything that a run depends on.

    Attributes:
        name: Name of the run's folder; None: made of the scene and the regularizers.
        seed: Seed of all randomness in the run.
        device: Where the field is trained: "auto" (a GPU if there is one), "cpu" or "cuda".
        scene: One of `nerfreg.scenes.SCENES`.
        field: Hash grid and networks.
        sampler: Samples along a ray.
        optim: Optimizer and learning rate.
        train: Budget and rays of a step.
        eval: Scores, and when they are taken.
        reg: The selected plugins by name.
    """

    name: str | None = None
    seed: int = 0
    device: str = "auto"
    # Any, because each scene format has a dataclass of its own, which the configuration files name.
    scene: Any = None
    field: FieldConfig = dataclasses.field(default_factory=FieldConfig)
    sampler: SamplerConfig = dataclasses.field(default_factory=SamplerConfig)
    optim: OptimConfig = dataclasses.field(default_factory=OptimConfig)
    train: TrainConfig = dataclasses.field(default_factory=TrainConfig)
    eval: EvalConfig = dataclasses.field(default_factory=EvalConfig)
    reg: dict[str, Any] = dataclasses.field(default_factory=dict)


def register() -> list[PluginInfo]:
    """Tell Hydra all schemas and search paths.

    Returns:
        The installed plugins, the broken ones included.
    """
    OmegaConf.register_new_resolver("run_name", run_name, replace=True)
    OmegaConf.register_new_resolver("by_layout", _by_layout, replace=True)
    store = ConfigStore.instance()
    store.store(name="schema", node=Config)
    for name in SCENES:
        store.store(group="scene", name=f"{name}{SCHEMA}", node=scene_schema(name))
    plugins = store_plugins(installed())
    register_search_path(plugins)
    return plugins


def scene_schema(name: str) -> Any:
    """Return the dataclass of a scene format, with a key `format` by which a saved run finds it."""
    cls = SCENES[name]
    return dataclasses.make_dataclass(cls.__name__, [("format", str, name)], bases=(cls,))


def _by_layout(*values: Any, _root_: DictConfig) -> Any:
    """A value in a preset that depends on the kind of capture.

    It is written `${by_layout:FORWARD,ORBIT}`, where ORBIT is for objects and rooms, or
    `${by_layout:FORWARD,OBJECT,ROOM}`. It is FORWARD as long as the kind is not known.
    """
    names = VALUES.get(len(values))
    if names is None:
        forms = " or ".join(",".join(map(str.upper, names)) for names in VALUES.values())
        raise NerfregError(f"by_layout takes the values {forms}, not {len(values)} of them")
    own = {name: {"value": value} for name, value in zip(names, values, strict=True)}
    layout = OmegaConf.select(_root_, "scene.layout", default=None)
    return defaults_of(layout, own).get("value", values[0])
