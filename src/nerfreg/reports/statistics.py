"""Means over seeds and over scenes, and which runs they are made of."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from nerfreg.reports.grouping import Setting, by_method, by_setting
from nerfreg.reports.records import RunRecord


@dataclass(frozen=True)
class Statistic:
    """mean, and std: the sample standard deviation (None for a single value), of `count` values."""

    mean: float
    std: float | None
    count: int


def summarize(values: Iterable[float | None]) -> Statistic | None:
    """Of the values that are known; None if none is."""
    known = [value for value in values if value is not None]
    if not known:
        return None
    return Statistic(
        statistics.fmean(known), statistics.stdev(known) if len(known) > 1 else None, len(known)
    )


def mean_of_means(scenes: Sequence[Statistic | None]) -> Statistic | None:
    """The mean over scenes of their means; None unless every scene has one.

    std: that of a mean over one run of each scene, sqrt(sum of variances) / number of scenes, where all have one.
    """
    means = [scene for scene in scenes if scene is not None]
    if not means or len(means) < len(scenes):
        return None
    deviations = [scene.std for scene in means if scene.std is not None]
    std = math.hypot(*deviations) / len(means) if len(deviations) == len(means) else None
    return Statistic(
        statistics.fmean(scene.mean for scene in means), std, sum(scene.count for scene in means)
    )


def complete(records: Sequence[RunRecord]) -> list[RunRecord]:
    """Those that have ended well: all that is averaged."""
    return [record for record in records if record.final is not None]


def ordered_methods(records: Sequence[RunRecord], first: str) -> dict[str, list[RunRecord]]:
    """Runs by method; `first`, and what is called so with additions, stands first, the rest as they were found."""
    methods = by_method(records)
    return dict(
        sorted(methods.items(), key=lambda item: (item[0] != first, not item[0].startswith(first)))
    )


def without_repetitions(
    records: Sequence[RunRecord],
) -> tuple[list[RunRecord], dict[Setting, list[str]]]:
    """One run for each method, scene, number of views and seed, and a note for each that is left out.

    Of several the last that is complete stays; where none is, the one that has come furthest.
    """
    kept = dict[tuple[object, ...], RunRecord]()
    for record in records:
        key = (record.method, record.scene, record.views, record.held_out, record.seed)
        kept[key] = max((kept.get(key, record), record), key=_rank)
    stay = {record.folder for record in kept.values()}
    notes: dict[Setting, list[str]] = {}
    for setting, runs in by_setting(records).items():
        for left_out in (run for run in runs if run.folder not in stay and run.failure is None):
            better = kept[
                left_out.method, left_out.scene, left_out.views, left_out.held_out, left_out.seed
            ]
            notes.setdefault(setting, []).append(
                f"{left_out.method}, seed {left_out.seed}, was run more than once: {better.folder} counts, "
                f"{left_out.folder} does not."
            )
    return [
        record for record in records if record.folder in stay or record.failure is not None
    ], notes


def _rank(record: RunRecord) -> tuple[bool, float, float, str]:
    """Which of two runs of one seed counts: the greater."""
    came = record.evaluations[-1].train_seconds if record.evaluations else 0.0
    return record.final is not None, record.finished or 0.0, came, str(record.folder)
