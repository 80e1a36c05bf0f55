"""Where configuration comes from, and its types: every key is known and checked before a run starts.

The schema is the dataclasses of the rooms (field, sampler, ...), of the scenes and of the installed plugins. The
values are the YAML files of four places, the first that has a file wins: the package's own `conf`, the user's
(`./conf`, then `$XDG_CONFIG_HOME/nerfreg`), and a folder `conf` beside a plugin's module.
"""

from __future__ import annotations

import dataclasses
import os
import sys
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import DictConfig, OmegaConf

from nerfreg.config.naming import run_name
from nerfreg.errors import NerfregError
from nerfreg.hooks import Regularizer
from nerfreg.nearest import nearest
from nerfreg.registry import Hooks, PluginInfo, installed

if TYPE_CHECKING:
    from nerfreg.evaluation import EvalConfig
    from nerfreg.field import FieldConfig
    from nerfreg.rendering import SamplerConfig
    from nerfreg.training import OptimConfig, TrainConfig
else:
    # These rooms import this module. OmegaConf takes their types from the default values instead.
    EvalConfig = FieldConfig = SamplerConfig = OptimConfig = TrainConfig = Any

ROOMS = ("field", "sampler", "optim", "train", "eval")


def _late(module: str, name: str) -> Any:
    """Makes `module.name()`, and imports the module only then."""
    return lambda: getattr(import_module(module), name)()


@dataclass
class Config:
    """Everything a run depends on.

    scene: one of `nerfreg.scenes.SCENES`. reg: the selected plugins by name.
    name: what the run's folder is called; made of scene and regularizers if None.
    device: "auto" (a GPU if there is one), "cpu" or "cuda".
    """

    name: str | None = None
    seed: int = 0
    device: str = "auto"
    scene: Any = None
    field: FieldConfig = dataclasses.field(default_factory=_late("nerfreg.field", "FieldConfig"))
    sampler: SamplerConfig = dataclasses.field(
        default_factory=_late("nerfreg.rendering", "SamplerConfig")
    )
    optim: OptimConfig = dataclasses.field(default_factory=_late("nerfreg.training", "OptimConfig"))
    train: TrainConfig = dataclasses.field(default_factory=_late("nerfreg.training", "TrainConfig"))
    eval: EvalConfig = dataclasses.field(default_factory=_late("nerfreg.evaluation", "EvalConfig"))
    reg: dict[str, Any] = dataclasses.field(default_factory=dict)


def register() -> list[PluginInfo]:
    """Tell Hydra all schemas and search paths; returns the installed plugins, broken ones included."""
    from nerfreg.scenes import SCENES

    OmegaConf.register_new_resolver("run_name", run_name, replace=True)
    OmegaConf.register_new_resolver("by_layout", _by_layout, replace=True)
    store = ConfigStore.instance()
    store.store(name="schema", node=Config)
    for name in SCENES:
        store.store(group="scene", name=f"{name}_schema", node=scene_schema(name))
    plugins = [_store_plugin(plugin) for plugin in installed()]
    Plugins.instance().register(_SearchPath)
    _SearchPath.plugins = plugins
    return plugins


def _by_layout(forward: Any, orbit: Any, *, _root_: DictConfig) -> Any:
    """`${by_layout:FORWARD,ORBIT}` in a preset: what depends on how the cameras stand. FORWARD while nobody knows."""
    return orbit if OmegaConf.select(_root_, "scene.layout", default=None) == "orbit" else forward


def scene_schema(name: str) -> Any:
    """The dataclass of a scene format with one more key, `format`, by which a saved run finds its schema again."""
    from nerfreg.scenes import SCENES

    cls = SCENES[name]
    return dataclasses.make_dataclass(cls.__name__, [("format", str, name)], bases=(cls,))


def _store_plugin(plugin: PluginInfo) -> PluginInfo:
    if plugin.cls is None:
        return plugin
    try:
        node = plugin_schema(plugin.name, plugin.cls)
    except Exception as exception:  # a stranger's annotations may be anything
        error = f"its fields are no configuration: {exception}".partition("\n")[0]
        return dataclasses.replace(plugin, cls=None, error=error)
    # Absolute, so that a preset of the group `reg` can list the plugin among its defaults.
    package = f"_global_.reg.{plugin.name}"
    ConfigStore.instance().store(group="reg", name=plugin.name, node=node, package=package)
    return plugin


def plugin_schema(name: str, cls: type[Regularizer]) -> DictConfig:
    """The plugin's dataclass as a typed node, whose defaults follow `scene.layout` where the class says so."""
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


def own_folder() -> Path:
    """The package's `conf`: inside the package when installed, at the top of a source checkout."""
    package = Path(__file__).parents[1]
    inside, checkout = package / "conf", package.parents[1] / "conf"
    return inside if inside.is_dir() else checkout


def user_folders() -> list[Path]:
    """`./conf` and `$XDG_CONFIG_HOME/nerfreg`, where they exist."""
    home = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    folders = [Path.cwd() / "conf", Path(home) / "nerfreg"]
    return [
        folder
        for folder in folders
        if folder.is_dir() and folder.resolve() != own_folder().resolve()
    ]


def preset_folders(plugins: Sequence[PluginInfo]) -> list[Path]:
    """The folders `conf` that plugin packages ship beside their modules."""
    folders: dict[Path, None] = {}
    for plugin in plugins:
        module = sys.modules.get(plugin.cls.__module__) if plugin.cls else None
        package = sys.modules.get(module.__package__ or "") if module else None
        for path in getattr(package, "__path__", ()):
            folders[Path(path) / "conf"] = None
    return [folder for folder in folders if folder.is_dir()]


def options(group: str, plugins: Sequence[PluginInfo]) -> list[str]:
    """All choices of a config group."""
    folders = [own_folder(), *user_folders(), *preset_folders(plugins)]
    files = {path.stem for folder in folders for path in (folder / group).glob("*.yaml")}
    try:
        stored = {name.removesuffix(".yaml") for name in ConfigStore.instance().list(group)}
    except OSError:  # Hydra's way to say that it knows no such group
        stored = set()
    return sorted(name for name in files | stored if not name.endswith("_schema"))


class _SearchPath(SearchPathPlugin):
    plugins: Sequence[PluginInfo] = ()

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        for folder in user_folders():
            search_path.append("nerfreg-user", f"file://{folder.resolve()}")
        for folder in preset_folders(self.plugins):
            search_path.append("nerfreg-plugins", f"file://{folder}")


def _refuse_unknown(node: DictConfig, path: str = "") -> None:
    """A `+key=value` override can add keys that no dataclass has; they would change nothing, silently."""
    schema = OmegaConf.get_type(node)
    known = (
        {field.name for field in dataclasses.fields(schema)}
        if dataclasses.is_dataclass(schema)
        else None
    )
    for key in map(str, node):
        if known is not None and key not in known:
            raise NerfregError(f"unknown key '{path}{key}'; {nearest(key, known)}")
        child = node._get_node(key)
        if isinstance(child, DictConfig) and not (child._is_none() or child._is_missing()):
            _refuse_unknown(child, f"{path}{key}.")


def _refuse_unselected(node: DictConfig) -> None:
    for name in node.reg:
        cls = OmegaConf.get_type(node.reg, str(name))
        if not (cls and issubclass(cls, Regularizer)):
            raise NerfregError(f"reg.{name}: not a selected plugin; select it by +reg={name}")


def validated(node: DictConfig) -> Config:
    """The composed configuration as dataclasses.

    Where nobody has named the layout that defaults may depend on, the cameras are asked.
    Raises NerfregError where a part is not what its schema says.
    """
    from nerfreg.scenes import SCENES, SceneConfig, load_scene

    _refuse_unknown(node)
    scene = OmegaConf.to_object(node.scene) if OmegaConf.is_config(node.scene) else None
    if not isinstance(scene, SceneConfig) or node.scene.format not in SCENES:
        raise NerfregError(
            "scene: has no schema; begin the file's defaults list with e.g. `- llff_schema`"
        )
    _refuse_unselected(node)
    if scene.layout is None:
        node = deepcopy(node)
        node.scene.layout = load_scene(scene).layout
    config = OmegaConf.to_object(node)
    if not isinstance(config, Config):
        raise NerfregError(
            "the configuration has no schema; begin its defaults list with `- schema`"
        )
    for room in ROOMS:
        value = getattr(config, room)
        if not dataclasses.is_dataclass(value):
            raise NerfregError(
                f"{room}={value}: is a group of keys; `nerfreg train --cfg job` shows them"
            )
    Hooks(config.reg)  # refuses what cannot work together before anything is read
    return config
