"""The installed plugins: entry points, and what keeps one of them from being used."""

from __future__ import annotations

import inspect
import tomllib
from collections import Counter
from dataclasses import dataclass
from importlib.metadata import EntryPoint, PackageNotFoundError, distribution, entry_points
from pathlib import Path

from nerfreg import __version__
from nerfreg.errors import nearest
from nerfreg.hooks import PROJECT, HookSpecs, Regularizer

GROUP = "nerfreg.plugins"
HOOKS = tuple(name for name in vars(HookSpecs) if name.startswith("nerfreg_"))
CHECK_HOOKS = ("nerfreg_reference", "nerfreg_contract")


@dataclass(frozen=True)
class PluginInfo:
    """One entry point.

    Attributes:
        name: Of the entry point, by which the plugin is selected.
        package: The distribution that it comes from.
        version: Of that distribution.
        cls: The plugin's class; None if it cannot be used.
        error: Why it cannot be used.
    """

    name: str
    package: str
    version: str
    cls: type[Regularizer] | None
    error: str = ""

    @property
    def hook_points(self) -> tuple[str, ...]:
        """The hooks that act in a run, without their prefix, in the order of a step."""
        used = implemented(self.cls) if self.cls else ()
        return tuple(hook.removeprefix("nerfreg_") for hook in used if hook not in CHECK_HOOKS)

    @property
    def summary(self) -> str:
        """First line of the docstring."""
        return inspect.cleandoc(self.cls.__doc__ or "").partition("\n")[0] if self.cls else ""

    @property
    def state(self) -> str:
        """What is wrong with the plugin; `ok` if nothing is."""
        return self.error or "ok"


def installed() -> list[PluginInfo]:
    """Return all plugins by name, the broken ones included."""
    found = [(point.name, point, *_source(point)) for point in _entry_points()]
    claims = Counter(name for name, *_ in found)
    plugins = []
    for name, point, package, version in sorted(found, key=lambda item: (item[0], item[2])):
        if claims[name] > 1:
            packages = sorted(other for claimed, _, other, _ in found if claimed == name)
            error = f"claimed by both {' and '.join(packages)}; uninstall one of them"
            plugins.append(PluginInfo(name, package, version, None, error))
            continue
        try:
            cls = point.load()
            error = _mistake(cls)
        except Exception as exception:  # a foreign module may raise anything
            error = f"failed to import: {type(exception).__name__}: {exception}".partition("\n")[0]
        plugins.append(PluginInfo(name, package, version, None if error else cls, error))
    return plugins


def _entry_points() -> list[EntryPoint]:
    points = list(entry_points(group=GROUP))
    try:
        distribution(PROJECT)
    except PackageNotFoundError:
        # A source checkout on PYTHONPATH has no metadata; its pyproject.toml says what it would
        # register.
        points += _checkout_entry_points(Path(__file__).parents[3] / "pyproject.toml")
    return points


def _checkout_entry_points(pyproject: Path) -> list[EntryPoint]:
    if not pyproject.is_file():
        return []
    project = tomllib.loads(pyproject.read_text(encoding="utf-8")).get("project", {})
    if project.get("name") != PROJECT:
        return []
    declared = project.get("entry-points", {}).get(GROUP, {})
    return [EntryPoint(name, value, GROUP) for name, value in declared.items()]


def _source(point: EntryPoint) -> tuple[str, str]:
    if point.dist is None:
        return PROJECT, __version__
    return point.dist.name, point.dist.version


def implemented(cls: type[Regularizer]) -> tuple[str, ...]:
    """Return the hooks that a plugin implements, in the order of a run."""
    return tuple(hook for hook in HOOKS if hasattr(getattr(cls, hook, None), f"{PROJECT}_impl"))


def _mistake(cls: object) -> str:
    """What keeps the object behind an entry point from being a plugin, or nothing."""
    if not (isinstance(cls, type) and issubclass(cls, Regularizer)):
        return f"{cls!r} does not derive from nerfreg.Regularizer"
    if "__dataclass_params__" not in vars(cls):
        return f"class {cls.__name__} is not decorated with @dataclass"
    for name in dir(cls):
        is_hook = hasattr(getattr(cls, name, None), f"{PROJECT}_impl")
        if (is_hook or name.startswith("nerfreg_")) and name not in HOOKS:
            return f"{cls.__name__}.{name} is not a hook; {nearest(name, HOOKS)}"
        if name in HOOKS and not is_hook:
            return f"{cls.__name__}.{name} is not decorated with @hookimpl"
    return ""


def origin(cls: type[Regularizer]) -> str:
    """Return the package that a plugin's class comes from, with its version."""
    for plugin in installed():
        if plugin.cls is cls or (plugin.cls is not None and plugin.cls in cls.__bases__):
            return f"{plugin.package} {plugin.version}"
    return cls.__module__
