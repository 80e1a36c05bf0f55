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
from nerfreg.config.search_path import SCHEMA, register_search_path
from nerfreg.evaluation.config import EvalConfig
from nerfreg.field.config import FieldConfig
from nerfreg.hooks import Regularizer
from nerfreg.registry import PluginInfo, installed
from nerfreg.rendering.config import SamplerConfig
from nerfreg.scenes import SCENES
from nerfreg.training.config import OptimConfig, TrainConfig


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
    plugins = [_store_plugin(plugin) for plugin in installed()]
    register_search_path(plugins)
    return plugins


def scene_schema(name: str) -> Any:
    """Return the dataclass of a scene format, with a key `format` by which a saved run finds it."""
    cls = SCENES[name]
    return dataclasses.make_dataclass(cls.__name__, [("format", str, name)], bases=(cls,))


def plugin_schema(name: str, cls: type[Regularizer]) -> DictConfig:
    """Return a plugin's dataclass as a typed node.

    Its defaults follow `scene.layout` where the class says so (`Regularizer.by_layout`).
    """
    node: DictConfig = OmegaConf.structured(cls)
    defaults = OmegaConf.to_container(node)
    assert isinstance(defaults, dict)

    def by_layout(key: str, *, _root_: DictConfig) -> Any:
        layout = OmegaConf.select(_root_, "scene.layout", default="")
        return cls.by_layout.get(layout, {}).get(key, defaults[key])

    OmegaConf.register_new_resolver(f"{name}_by_layout", by_layout, replace=True)
    for values in cls.by_layout.values():
        for key in values:
            node[key] = f"${{{name}_by_layout:{key}}}"
    return node


def _by_layout(forward: Any, orbit: Any, *, _root_: DictConfig) -> Any:
    """`${by_layout:FORWARD,ORBIT}` in a preset: a value that depends on how the cameras stand.

    It is FORWARD as long as the layout is not known.
    """
    return orbit if OmegaConf.select(_root_, "scene.layout", default=None) == "orbit" else forward


def _store_plugin(plugin: PluginInfo) -> PluginInfo:
    if plugin.cls is None:
        return plugin
    try:
        node = plugin_schema(plugin.name, plugin.cls)
    except Exception as exception:  # the annotations of a foreign package may be anything
        error = f"its fields are no configuration: {exception}".partition("\n")[0]
        return dataclasses.replace(plugin, cls=None, error=error)
    # Absolute, so that a preset of the group `reg` can list the plugin among its defaults.
    package = f"_global_.reg.{plugin.name}"
    ConfigStore.instance().store(group="reg", name=plugin.name, node=node, package=package)
    return plugin
