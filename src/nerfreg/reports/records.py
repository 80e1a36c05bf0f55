"""What a report knows of a run: what its folder says, read once, with its types."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

METRICS = ("psnr", "ssim", "lpips", "average", "depth_rmse")
VANILLA = "vanilla"
"""The method without regularizers."""

Key = TypeVar("Key")


@dataclass(frozen=True, order=True)
class Setting:
    """What runs must share to be compared.

    Attributes:
        scene: Its name.
        views: Number of training views.
        held_out: Whether runs are scored on held-out training views.
    """

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
class EvaluationRecord:
    """One line of `metrics.jsonl`, or `results.json`. A metric that could not be had is None.

    Attributes:
        step: Number of steps so far.
        train_seconds: Of training alone, without compilation and evaluation.
        psnr: In dB.
        views: How many test views were scored.
        whole: Whether these were all test views at full size, as at the end of a run.
    """

    step: int
    train_seconds: float
    psnr: float | None = None
    ssim: float | None = None
    lpips: float | None = None
    average: float | None = None
    depth_rmse: float | None = None
    views: int = 0
    whole: bool = False


@dataclass(frozen=True)
class RunRecord:
    """One run folder.

    Attributes:
        folder: Where it lies.
        method: What sets the run apart from others on its scene: the regularizers or their preset,
            then every other setting that was overridden, without scene and seed.
        setting: What the run may be compared in.
        evaluations: In the order of time; the last one is `final` if the run is complete.
        final: All test views at full size. None while the run is being written, and for one that
            failed.
        points_per_second: Of the whole run; None while it is being written.
        peak_memory_mb: Of the whole run; None while it is being written.
        settings: The configuration, flat: `sampler.coarse` -> 32.
        command: The overrides that reproduce the run.
        shared: Overrides that all runs in the same setting have, and that `method` leaves out.
        failure: Why it failed; None if it did not.
        threads: CPU threads that it trained with.
        versions: Of the packages that it ran with.
        finished: When `results.json` was written, in seconds since 1970.
    """

    folder: Path
    method: str
    setting: Setting
    seed: int = 0
    evaluations: tuple[EvaluationRecord, ...] = ()
    final: EvaluationRecord | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    command: tuple[str, ...] = ()
    points_per_second: float | None = None
    peak_memory_mb: float | None = None
    shared: tuple[str, ...] = ()
    failure: str | None = None
    threads: int | None = None
    versions: Mapping[str, str | None] = field(default_factory=dict)
    finished: float | None = None

    @property
    def last(self) -> EvaluationRecord | None:
        """The latest evaluation, if there is any."""
        return self.evaluations[-1] if self.evaluations else None

    @property
    def state(self) -> str:
        """One of "failed", "complete" and "incomplete"."""
        if self.failure is not None:
            return "failed"
        return "incomplete" if self.final is None else "complete"

    @property
    def progress(self) -> str:
        """How far a run that is not complete has come."""
        return f"{self.last.train_seconds:.0f} s so far" if self.last else "not scored yet"


def grouped(
    runs: Iterable[RunRecord], key: Callable[[RunRecord], Key]
) -> dict[Key, list[RunRecord]]:
    """Return runs by `key`, groups and their members in the order in which they appear."""
    groups: dict[Key, list[RunRecord]] = {}
    for run in runs:
        groups.setdefault(key(run), []).append(run)
    return groups


def by_setting(runs: Iterable[RunRecord]) -> dict[Setting, list[RunRecord]]:
    """Return runs by setting, in the order of the scenes' names."""
    return dict(sorted(grouped(runs, lambda run: run.setting).items()))


def by_method(runs: Iterable[RunRecord]) -> dict[str, list[RunRecord]]:
    """Return runs by method: vanilla and its variants first, the rest as they appear."""
    methods = grouped(runs, lambda run: run.method)
    names = sorted(methods, key=lambda name: (name != VANILLA, not name.startswith(VANILLA)))
    return {name: methods[name] for name in names}


def complete(runs: Iterable[RunRecord]) -> list[RunRecord]:
    """Return the runs that ended well: all that is averaged."""
    return [run for run in runs if run.final is not None]


def without_repetitions(
    runs: Sequence[RunRecord],
) -> tuple[list[RunRecord], dict[Setting, list[str]]]:
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


def _rank(run: RunRecord) -> tuple[bool, float, float, str]:
    came = run.last.train_seconds if run.last else 0.0
    return run.final is not None, run.finished or 0.0, came, str(run.folder)
