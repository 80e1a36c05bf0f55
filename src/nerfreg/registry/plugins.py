"""The installed plugins: entry points, the names by which they are selected, and their faults."""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, PackageNotFoundError, distribution, entry_points
from pathlib import Path
from typing import Any

from nerfreg import __version__
from nerfreg.errors import nearest
from nerfreg.hooks import PROJECT, HookSpecs, Regularizer
from nerfreg.registry.mistakes import import_mistake, mistake_of

GROUP = "nerfreg.plugins"
HOOKS = tuple(name for name in vars(HookSpecs) if name.startswith("nerfreg_"))
CHECK_HOOKS = ("nerfreg_reference", "nerfreg_contract")
ADDRESS = "_plugin"
"""Attribute of an instance with the address of its plugin, set by the configuration."""


@dataclass(frozen=True)
class PluginInfo:
    """One entry point.

    Attributes:
        name: Of the entry point.
        package: The distribution that it comes from.
        version: Of that distribution.
        cls: The plugin's class; None if it cannot be used.
        error: Why it cannot be used.
        rivals: Other packages with a plugin of this name.
    """

    name: str
    package: str
    version: str
    cls: type[Regularizer] | None
    error: str = ""
    rivals: tuple[str, ...] = ()

    @property
    def has_name(self) -> bool:
        """Whether the name alone selects the plugin: nobody else has it, or it is a built-in."""
        return not self.rivals or self.package == PROJECT

    @property
    def address(self) -> str:
        """What selects the plugin: its name, or "package:name" where the name is another's."""
        return self.name if self.has_name else f"{self.package}:{self.name}"

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
    def clash(self) -> str:
        """What the name is not: the plugin's own; empty if it is."""
        if self.has_name:
            return ""
        owner = f"that of a built-in; select this one by +reg={self.address}"
        others = f"also that of {' and '.join(self.rivals)}; select it by +reg={self.address}"
        return f"the name '{self.name}' is {owner if PROJECT in self.rivals else others}"

    @property
    def state(self) -> str:
        """What is wrong with the plugin or its name; `ok` if nothing is."""
        return self.error or self.clash or "ok"


def installed() -> list[PluginInfo]:
    """Return all plugins by name, the broken ones included."""
    found = [(point, *_source(point)) for point in _entry_points()]
    plugins = []
    for point, package, version in sorted(found, key=lambda item: (item[0].name, item[1])):
        rivals = {other for claimed, other, _ in found if claimed.name == point.name} - {package}
        plugin = PluginInfo(point.name, package, version, None, rivals=tuple(sorted(rivals)))
        plugins.append(_loaded(plugin, point))
    return plugins


def by_address(plugins: Iterable[PluginInfo]) -> dict[str, PluginInfo]:
    """Return plugins by all that selects them: "package:name", and the name where it is theirs."""
    found = {}
    for plugin in plugins:
        found[plugin.address] = found[f"{plugin.package}:{plugin.name}"] = plugin
    return found


def find_plugin(address: str, plugins: Iterable[PluginInfo]) -> PluginInfo | None:
    """Return the plugin that a name or a "package:name" selects; None if there is none."""
    package, colon, name = address.rpartition(":")
    known = by_address(plugins)
    for key, plugin in known.items():
        # Indexes of packages do not tell - from _ either.
        if key == address or (
            colon and plugin.name == name and _same(plugin.package) == _same(package)
        ):
            return plugin
    return None


def why_not(address: str, plugins: Sequence[PluginInfo]) -> str:
    """Return why nothing can be selected by this name of a plugin; empty if nobody claims it."""
    plugin = find_plugin(address, plugins)
    if plugin is not None:
        return f"plugin '{address}' of package {plugin.package}: {plugin.error}"
    claims = [plugin for plugin in plugins if plugin.name == address]
    if claims:
        packages = " and ".join(plugin.package for plugin in claims)
        choices = " or ".join(f"+reg={plugin.address}" for plugin in claims)
        return f"plugin '{address}' is claimed by both {packages}; write {choices}"
    package, colon, name = address.rpartition(":")
    if colon:
        own = [plugin.name for plugin in plugins if _same(plugin.package) == _same(package)]
        if not own:
            hint = nearest(package, {plugin.package for plugin in plugins})
            return f"no plugin comes from package '{package}'; {hint}"
        return f"package {package} has no plugin '{name}'; {nearest(name, own)}"
    return ""


def plugin_name(name: str, plugin: Regularizer) -> str:
    """Return which plugin an instance is, by its address (`PluginInfo.address`).

    Args:
        name: The name of the instance in the configuration, which is the answer for one that no
            configuration made.
        plugin: The instance.
    """
    return str(vars(plugin).get(ADDRESS, name))


def conflicts_of(plugin: Regularizer, plugins: Mapping[str, Regularizer]) -> list[str]:
    """Return the names of the instances with which a plugin cannot be active in one run.

    Args:
        plugin: The plugin that says so (`Regularizer.conflicts`).
        plugins: All instances of the run, by name.
    """
    named = {name: plugin_name(name, other) for name, other in plugins.items()}
    return [name for name, address in named.items() if address in plugin.conflicts]


def is_used(plugin: Regularizer) -> bool:
    """Return whether a plugin has a part in its run, at least at times: its weight is not 0."""
    return plugin.weight != 0 or "weight" in plugin.schedules


def with_changes(plugin: Regularizer, **changes: Any) -> Regularizer:
    """Return a new instance of a plugin with its configuration, schedules included, changed."""
    made = replace(plugin, **changes)
    for key in (ADDRESS, "schedules"):
        if key in vars(plugin):
            vars(made)[key] = vars(plugin)[key]
    return made


def implemented(cls: type[Regularizer]) -> tuple[str, ...]:
    """Return the hooks that a plugin implements, in the order of a run."""
    return tuple(hook for hook in HOOKS if hasattr(getattr(cls, hook, None), f"{PROJECT}_impl"))


def origin(cls: type[Regularizer]) -> str:
    """Return the package that a plugin's class comes from, with its version."""
    for plugin in installed():
        if plugin.cls is cls or (plugin.cls is not None and plugin.cls in cls.__bases__):
            return f"{plugin.package} {plugin.version}"
    return cls.__module__


def _loaded(plugin: PluginInfo, point: EntryPoint) -> PluginInfo:
    try:
        cls = point.load()
        error = mistake_of(cls)
    except Exception as exception:  # a foreign module may raise anything
        error = import_mistake(exception)
    return replace(plugin, error=error) if error else replace(plugin, cls=cls)


def _same(package: str) -> str:
    return re.sub(r"[-_.]+", "-", package).lower()


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
