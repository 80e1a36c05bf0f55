"""Runs with names, and in groups."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from nerfreg.runs.records import RunRecord

VANILLA = "vanilla"
"""The method without regularizers."""

Key = TypeVar("Key")


@dataclass(frozen=True, order=True)
class Setting:
    """What runs must share to be compared: the scene, how many training views, which test views."""

    scene: str
    views: int
    held_out: bool = False

    @property
    def title(self) -> str:
        """The setting as a heading: "fern, 3 views"."""
        ending = ", scored on held-out training views" if self.held_out else ""
        return f"{self.scene}, {counted(self.views, 'view')}{ending}"

    @property
    def name(self) -> str:
        """The setting as part of a file's name: "fern-3"."""
        return slug(f"{self.scene}-{self.views}" + ("-held-out" if self.held_out else ""))


@dataclass(frozen=True)
class NamedRun(RunRecord):
    """A run with a name.

    Attributes:
        method: What sets it apart from others in its setting: the regularizers or their preset,
            then every other setting that was overridden, without scene and seed.
        shared: Overrides that all runs in the same setting have, and that `method` leaves out.
    """

    method: str = VANILLA
    shared: tuple[str, ...] = ()

    @property
    def setting(self) -> Setting:
        """What it may be compared in."""
        return Setting(self.scene, self.views, self.held_out)


def grouped(runs: Iterable[NamedRun], key: Callable[[NamedRun], Key]) -> dict[Key, list[NamedRun]]:
    """Return runs by `key`, groups and their members in the order in which they appear."""
    groups: dict[Key, list[NamedRun]] = {}
    for run in runs:
        groups.setdefault(key(run), []).append(run)
    return groups


def by_setting(runs: Iterable[NamedRun]) -> dict[Setting, list[NamedRun]]:
    """Return runs by setting, in the order of the scenes' names."""
    return dict(sorted(grouped(runs, lambda run: run.setting).items()))


def by_method(runs: Iterable[NamedRun]) -> dict[str, list[NamedRun]]:
    """Return runs by method: vanilla and its variants first, the rest as they appear."""
    methods = grouped(runs, lambda run: run.method)
    names = sorted(methods, key=lambda name: (name != VANILLA, not name.startswith(VANILLA)))
    return {name: methods[name] for name in names}


def complete(runs: Iterable[NamedRun]) -> list[NamedRun]:
    """Return the runs that ended well: all that is averaged."""
    return [run for run in runs if run.final is not None]


def without_repetitions(
    runs: Sequence[NamedRun],
) -> tuple[list[NamedRun], dict[Setting, list[str]]]:
    """Keep one run for each setting, method and seed, and all that failed.

    Of several the last that is complete stays; where none is, the one that has come furthest.

    Returns:
        The runs, and by setting a note for each that is left out.
    """
    kept = {
        key: max(group, key=_rank)
        for key, group in grouped(runs, lambda run: (run.setting, run.method, run.seed)).items()
    }
    stay = {run.folder for run in kept.values()} | {run.folder for run in runs if run.failure}
    notes: dict[Setting, list[str]] = {}
    for run in runs:
        if run.folder not in stay:
            better = kept[run.setting, run.method, run.seed].folder
            notes.setdefault(run.setting, []).append(
                f"{run.method}, seed {run.seed}, was run more than once: "
                f"{better} counts, {run.folder} does not."
            )
    return [run for run in runs if run.folder in stay], notes


def slug(text: str) -> str:
    """Return lower-case letters, digits, dots and single dashes, for a file or a part of a page."""
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-") or "unnamed"


def counted(count: int, noun: str) -> str:
    """Return a number with its noun: "1 view", "3 views"."""
    return f"{count} {noun}{'s' * (count != 1)}"


def _rank(run: NamedRun) -> tuple[bool, float, float, str]:
    came = run.last.train_seconds if run.last else 0.0
    return run.final is not None, run.finished or 0.0, came, str(run.folder)
