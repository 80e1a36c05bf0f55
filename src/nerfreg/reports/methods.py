"""What a run is called in a table: its regularizers, then whatever else sets it apart from the runs beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from nerfreg.reports.grouping import by_method, by_setting
from nerfreg.reports.records import RunRecord

VANILLA = "vanilla"
SCENE_KEYS = (
    "format", "split", "train", "test", "held_out", "background", "factor", "size", "height", "test_views", "seed",
)  # fmt: skip
"""Keys of a scene that decide which photographs are compared: runs that differ in them share no table."""
BUDGET = ("train.steps", "train.seconds")
SILENT = (
    "name",
    "seed",
    "device",
    "scene",
    "scene.path",
    "scene.views",
    "train.threads",
    "train.quiet",
    *BUDGET,
)
SILENT_GROUPS = (
    "eval",
    "hydra",
    "train.check",
    "train.check_every",
    *(f"scene.{key}" for key in SCENE_KEYS),
)
"""Overrides that say nothing of the method."""
FEW = 3
"""As many keys stand in a name; where more of them differ, variants are numbered."""


def method_of(overrides: Sequence[str], settings: Mapping[str, object]) -> str:
    """The name that the user gave, or the regularizers and the overrides: `combinerf, sampler=importance`."""
    return str(settings.get("name") or ", ".join(_parts(overrides, settings)))


def scenes_distinguished(records: Sequence[RunRecord]) -> list[RunRecord]:
    """Add to a scene's name what differs among runs that share it, and should not share a table: `chair (factor=8)`."""
    named = list(records)
    for group in _grouped(records, lambda record: (record.scene, record.views, record.held_out)):
        keys = [
            key
            for key in SCENE_KEYS
            if len({_text(records[i].settings.get(f"scene.{key}")) for i in group}) > 1
        ]
        for index in group if keys else ():
            record = records[index]
            differences = ", ".join(
                f"{key}={_text(record.settings.get(f'scene.{key}'))}" for key in keys
            )
            named[index] = replace(record, scene=f"{record.scene} ({differences})")
    return named


def distinguished(records: Sequence[RunRecord]) -> list[RunRecord]:
    """Name methods by what sets them apart from the others, so that no two configurations share a name.

    A name that a user gave to several methods is the name of a study, and none of a method. Overrides that all runs
    of a scene have in common are moved to `shared`, if there is more than one method.
    Budgets are named where runs of one scene differ in them. What else differs among runs of one name is added to it.
    """
    return _variants_apart(_budgets_apart(_without_shared(_without_studies(records))))


def _parts(overrides: Sequence[str], settings: Mapping[str, object]) -> list[str]:
    """The regularizers, then the overrides in the order of their keys."""
    chosen = "+".join(_selected(settings)) or VANILLA
    others: dict[str, str] = {}
    for override in overrides:
        key, equals, value = override.lstrip("+").partition("=")
        if key.startswith("~"):  # deleted, whatever its value was
            equals = value = ""
        if key == "reg" and equals:
            chosen = (
                "+".join(sorted(part.strip(" '\"") for part in value.strip("[]").split(",")))
                or VANILLA
            )
        elif not _silent(key.lstrip("~").partition("@")[0].replace("/", ".")):
            known = key in settings and not isinstance(settings[key], list)
            others[key.removeprefix("reg.")] = (
                (_text(settings[key]) if known else value) if equals else ""
            )
    return [chosen, *(f"{key}={value}" if value else key for key, value in sorted(others.items()))]


def _silent(key: str) -> bool:
    return key in SILENT or any(
        key == group or key.startswith(f"{group}.") for group in SILENT_GROUPS
    )


def _without_studies(records: Sequence[RunRecord]) -> list[RunRecord]:
    named = list(records)
    for group in _grouped(records, lambda record: record.settings.get("name")):
        methods = [
            ", ".join(_parts(records[index].command, records[index].settings)) for index in group
        ]
        for index, method in zip(group, methods, strict=True) if len(set(methods)) > 1 else ():
            named[index] = replace(records[index], method=method)
    return named


def _without_shared(records: Sequence[RunRecord]) -> list[RunRecord]:
    settings = by_setting(records).values()
    if all(len(by_method(group)) == 1 for group in settings):
        return list(records)
    named: dict[Path, RunRecord] = {}
    for group in settings:
        parts = {run.folder: _parts(run.command, run.settings) for run in group}
        # A name that a user gave stays as it is.
        unnamed = [run.folder for run in group if run.method == ", ".join(parts[run.folder])]
        common = (
            set.intersection(*(set(parts[folder][1:]) for folder in unnamed))
            if unnamed
            else set[str]()
        )
        for run in group:
            first, *others = parts[run.folder]
            kept = ", ".join([first, *(part for part in others if part not in common)])
            method = kept if run.folder in unnamed else run.method
            named[run.folder] = replace(run, method=method, shared=tuple(sorted(common)))
    return [named[record.folder] for record in records]


def _budgets_apart(records: Sequence[RunRecord]) -> list[RunRecord]:
    if all(len({budget(run) for run in group}) == 1 for group in by_setting(records).values()):
        return list(records)
    return [replace(record, method=f"{record.method}, {budget(record)}") for record in records]


def budget(record: RunRecord) -> str:
    """`600 s`, `1500 steps`, or whichever is spent first: `1500 steps or 600 s`."""
    steps, seconds = (record.settings.get(key) for key in BUDGET)
    given = (
        None if steps is None else f"{_text(steps)} steps",
        None if seconds is None else f"{_text(seconds)} s",
    )
    return " or ".join(filter(None, given)) or "unknown budget"


def _variants_apart(records: Sequence[RunRecord]) -> list[RunRecord]:
    named = list(records)
    identities = [identity(record) for record in records]
    for group in _grouped(records, lambda record: record.method):
        keys: dict[str, None] = {}
        for same_scene in _grouped(
            records, lambda run: (run.scene, run.views, run.held_out), group
        ):
            keys.update(dict.fromkeys(_differing([identities[index] for index in same_scene])))
        variants: dict[tuple[str, ...], int] = {}
        for index in group if keys else ():
            record, known = records[index], identities[index]
            variant = tuple(
                f"{key.removeprefix('reg.')}={known[key]}" for key in keys if key in known
            )
            number = variants.setdefault(variant, len(variants) + 1)
            addition = ", ".join(variant) if len(keys) <= FEW else f"variant {number}"
            named[index] = replace(
                record, method=f"{record.method} ({addition})" if addition else record.method
            )
    return named


def identity(record: RunRecord) -> dict[str, str]:
    """All that makes a run what it is beside scene, seed and budget: settings, threads and package versions.

    A value that is not known is left out: one that an older folder lacks, one still to be resolved, and the threads
    of a run that is not complete, which are wishes.
    """
    known = {
        key: _text(value)
        for key, value in record.settings.items()
        if not _silent(key) or key == "device"
    }
    known |= {
        f"version of {package}": str(version)
        for package, version in record.versions.items()
        if version
    }
    known["reg"] = "+".join(_selected(record.settings)) or VANILLA
    if record.threads is not None and record.final is not None:
        known["threads"] = str(record.threads)
    return {key: value for key, value in known.items() if not value.startswith("${")}


def _differing(identities: Sequence[Mapping[str, str]]) -> list[str]:
    """Keys that have more than one value among those that have the key."""
    values: dict[str, set[str]] = {}
    for known in identities:
        for key, value in known.items():
            values.setdefault(key, set()).add(value)
    return sorted(key for key, found in values.items() if len(found) > 1)


def _selected(settings: Mapping[str, object]) -> list[str]:
    return sorted({key.split(".")[1] for key in settings if key.startswith("reg.")})


def _grouped(
    records: Sequence[RunRecord],
    key: Callable[[RunRecord], object],
    indices: Iterable[int] | None = None,
) -> list[list[int]]:
    """Indices of records that agree in `key`."""
    groups: dict[object, list[int]] = {}
    for index in range(len(records)) if indices is None else indices:
        groups.setdefault(key(records[index]), []).append(index)
    return list(groups.values())


def _text(value: object) -> str:
    if isinstance(value, float):
        return format(value, "g")
    return "null" if value is None else str(value).replace(" ", "")
