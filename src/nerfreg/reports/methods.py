"""What a run is called: its regularizers, then whatever else sets it apart from others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from nerfreg.reports.records import VANILLA, NamedRun, by_setting, grouped

SCENE_KEYS = (
    "format", "split", "train", "test", "held_out", "background", "factor", "size", "height",
    "test_views", "seed",
)  # fmt: skip
"""Keys of a scene that decide which photographs are compared: runs that differ in them share no
table."""
BUDGET = {"train.steps": "steps", "train.seconds": "s"}
SILENT = (
    "name", "seed", "device", "scene", "scene.path", "scene.views", "train.threads", "train.quiet",
    "train.check_every", *BUDGET,
)  # fmt: skip
SILENT_GROUPS = ("eval", "hydra", "train.check", *(f"scene.{key}" for key in SCENE_KEYS))
"""Overrides that say nothing of the method."""
FEW = 3
"""As many keys stand in a name; where more of them differ, variants are numbered."""


def method_of(overrides: Sequence[str], settings: Mapping[str, Any]) -> str:
    """Return the name that the user gave, or regularizers and overrides: `kl, train.rays=64`."""
    return str(settings.get("name") or ", ".join(_parts(overrides, settings)))


def scenes_distinguished(runs: Sequence[NamedRun]) -> list[NamedRun]:
    """Tell apart scenes of one name whose runs should not share a table: `chair (factor=8)`."""

    def named(group: list[NamedRun]) -> list[NamedRun]:
        texts = (
            map(_text, (run.settings.get(f"scene.{key}") for key in SCENE_KEYS)) for run in group
        )
        known = [dict(zip(SCENE_KEYS, own, strict=True)) for own in texts]
        keys = _differing(known, SCENE_KEYS)
        endings = [", ".join(f"{key}={own[key]}" for key in keys) for own in known]
        scenes = [
            f"{group[0].scene} ({ending})" if ending else group[0].scene for ending in endings
        ]
        return [replace(run, scene=scene) for run, scene in zip(group, scenes, strict=True)]

    return _each_group(runs, lambda run: run.setting, named)


def distinguished(runs: Sequence[NamedRun]) -> list[NamedRun]:
    """Name methods by what sets them apart, so that no two configurations share a name.

    A name that a user gave to several methods is the name of a study, and none of a method. Where
    there is more than one method, overrides that all runs of a setting share are moved to `shared`.
    Budgets are named where runs of one setting differ in them. What else differs among runs of one
    name is added to it.
    """
    runs = _each_group(runs, lambda run: run.settings.get("name"), _without_studies)
    if any(len({run.method for run in group}) > 1 for group in by_setting(runs).values()):
        runs = _each_group(runs, lambda run: run.setting, _without_shared)
    if any(len(set(map(_budget, group))) > 1 for group in by_setting(runs).values()):
        runs = [replace(run, method=f"{run.method}, {_budget(run)}") for run in runs]
    return _each_group(runs, lambda run: run.method, _variants_apart)


def identity(run: NamedRun) -> dict[str, str]:
    """Return all that makes a run what it is beside scene, seed and budget.

    That is settings, threads and package versions. A value that is not known is left out: one that
    an older folder lacks, one still to be resolved, and the threads of a run that is not complete,
    which are wishes.
    """
    settings = run.settings.items()
    known = {key: _text(value) for key, value in settings if key == "device" or not _silent(key)}
    known |= {f"version of {package}": str(v) for package, v in run.versions.items() if v}
    # Which plugins these are is said by the next; older folders say it by their names alone.
    known = {key: value for key, value in known.items() if not _names_a_plugin(key)}
    known["reg"] = _regularizers(run.settings)
    if run.threads is not None and run.final is not None:
        known["threads"] = str(run.threads)
    return {key: value for key, value in known.items() if not value.startswith("${")}


def _each_group(
    runs: Sequence[NamedRun],
    key: Callable[[NamedRun], object],
    change: Callable[[list[NamedRun]], list[NamedRun]],
) -> list[NamedRun]:
    """Change the runs of each group, and return all in the order in which they came."""
    groups = grouped(runs, key).values()
    changed = {run.folder: run for group in groups for run in change(group)}
    return [changed[run.folder] for run in runs]


def _parts(overrides: Sequence[str], settings: Mapping[str, Any]) -> list[str]:
    """Return the regularizers, then the overrides in the order of their keys."""
    chosen = _regularizers(settings)
    others: dict[str, str] = {}
    for override in overrides:
        key, equals, value = override.lstrip("+").partition("=")
        if key.startswith("~"):
            # It is deleted, whatever its value was.
            equals = value = ""
        if key == "reg" and equals:
            # Hydra escapes the colon of "package:plugin" in the jobs of a sweep.
            words = value.replace("\\", "").strip("[]").split(",")
            selected = sorted(word.strip(" '\"") for word in words)
            chosen = "+".join(selected) or VANILLA
        elif not _silent(key.lstrip("~").partition("@")[0].replace("/", ".")):
            # A value as it was understood; a list as it was written.
            if equals and key in settings and not isinstance(settings[key], list):
                value = _text(settings[key])
            others[key.removeprefix("reg.")] = value
    return [chosen, *(f"{key}={value}" if value else key for key, value in sorted(others.items()))]


def _without_studies(group: list[NamedRun]) -> list[NamedRun]:
    methods = [", ".join(_parts(run.command, run.settings)) for run in group]
    if len(set(methods)) == 1:
        return group
    return [replace(run, method=method) for run, method in zip(group, methods, strict=True)]


def _without_shared(group: list[NamedRun]) -> list[NamedRun]:
    parts = {run.folder: _parts(run.command, run.settings) for run in group}
    # A name that a user gave stays as it is.
    unnamed = {run.folder for run in group if run.method == ", ".join(parts[run.folder])}
    overrides = [set(parts[folder][1:]) for folder in unnamed]
    common = set[str].intersection(*overrides) if overrides else set[str]()

    def method(run: NamedRun) -> str:
        kept = [part for part in parts[run.folder][1:] if part not in common]
        return ", ".join([parts[run.folder][0], *kept]) if run.folder in unnamed else run.method

    return [replace(run, method=method(run), shared=tuple(sorted(common))) for run in group]


def _budget(run: NamedRun) -> str:
    """Return `600 s`, `1500 steps`, or whichever is spent first: `1500 steps or 600 s`."""
    given = [(run.settings.get(key), unit) for key, unit in BUDGET.items()]
    parts = [f"{_text(size)} {unit}" for size, unit in given if size is not None]
    return " or ".join(parts) or "unknown budget"


def _variants_apart(group: list[NamedRun]) -> list[NamedRun]:
    identities = {run.folder: identity(run) for run in group}
    keys: dict[str, None] = {}
    # Weights may depend on the scene: only what differs on one scene makes a variant.
    for same_scene in grouped(group, lambda run: run.setting).values():
        known = [identities[run.folder] for run in same_scene]
        keys |= dict.fromkeys(_differing(known, sorted({key for own in known for key in own})))
    if not keys:
        return group
    numbers: dict[str, int] = {}
    named = []
    for run in group:
        own = identities[run.folder]
        variant = ", ".join(f"{key.removeprefix('reg.')}={own[key]}" for key in keys if key in own)
        number = numbers.setdefault(variant, len(numbers) + 1)
        ending = variant if len(keys) <= FEW else f"variant {number}"
        named.append(replace(run, method=f"{run.method} ({ending})") if ending else run)
    return named


def _differing(known: Sequence[Mapping[str, str]], keys: Sequence[str]) -> list[str]:
    """Return the keys that have more than one value among those that have the key."""
    return [key for key in keys if len({own[key] for own in known if key in own}) > 1]


def _regularizers(settings: Mapping[str, Any]) -> str:
    names = {key.split(".")[1] for key in settings if key.startswith("reg.")}
    # As on the command line: the same plugin may be there twice, under two names.
    plugins = {name: str(settings.get(f"reg.{name}.plugin", name)) for name in names}
    own = {name: plugin.rpartition(":")[2] for name, plugin in plugins.items()}
    selected = (plugins[name] if own[name] == name else f"{plugins[name]}@{name}" for name in names)
    return "+".join(sorted(selected)) or VANILLA


def _names_a_plugin(key: str) -> bool:
    parts = key.split(".")
    return len(parts) == 3 and parts[0] == "reg" and parts[2] == "plugin"


def _silent(key: str) -> bool:
    return key in SILENT or any(f"{key}.".startswith(f"{group}.") for group in SILENT_GROUPS)


def _text(value: object) -> str:
    if isinstance(value, float):
        return format(value, "g")
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{key}:{_text(item)}' for key, item in value.items())}}}"
    if isinstance(value, list):
        return f"[{','.join(map(_text, value))}]"
    return "null" if value is None else str(value).replace(" ", "")
