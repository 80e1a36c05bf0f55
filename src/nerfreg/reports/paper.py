"""Published numbers, from a CSV file, beside those of runs."""

from __future__ import annotations

import csv
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from nerfreg.errors import NerfregError
from nerfreg.reports.grouping import Setting
from nerfreg.reports.methods import VANILLA
from nerfreg.reports.records import RunRecord

COLUMNS = ("dataset", "views", "scene", "method", "psnr", "ssim", "lpips", "average")
VALUES = ("psnr", "ssim", "lpips", "average")
MEAN = "mean"
"""In place of a scene: a row over all scenes of its data set."""
PROTOCOLS: dict[str, dict[str, tuple[object, ...]]] = {
    "llff": {"scene.format": ("llff",), "scene.split": ("llff", None)},
    "nerf_synthetic": {
        "scene.format": ("blender",),
        "scene.split": ("nerf_synthetic_8", None),
        "scene.factor": (2,),
        "scene.background": ("white",),
    },
}
"""Settings under which published numbers of a data set may stand beside ours. A name alone says little."""


@dataclass(frozen=True)
class PaperRow:
    """A method on a scene as it was published; None for what was not."""

    dataset: str
    views: int
    scene: str
    method: str
    psnr: float | None
    ssim: float | None
    lpips: float | None
    average: float | None


def read_paper(path: Path) -> list[PaperRow]:
    """Rows of a CSV file with (at least) the columns of `PaperRow`; those that several tables repeat are merged.

    Raises NerfregError naming file, line and column of what cannot be read.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            missing = [column for column in COLUMNS if column not in (reader.fieldnames or ())]
            if missing:
                raise NerfregError(
                    f"{path}: no column {', '.join(missing)}; needed: {', '.join(COLUMNS)}"
                )
            rows = [_row(path, reader.line_num, line) for line in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise NerfregError(
            f"--paper {path}: cannot be read ({getattr(error, 'strerror', None) or error})"
        ) from error
    merged: dict[tuple[str, int, str, str], PaperRow] = {}
    for row in rows:
        key = (row.dataset, row.views, row.scene, row.method)
        before = merged.setdefault(key, row)
        gaps = {name: getattr(row, name) for name in VALUES if getattr(before, name) is None}
        merged[key] = replace(before, **gaps)
    return list(merged.values())


def rows_of_scene(
    paper: Sequence[PaperRow], scene: str, views: int, settings: Mapping[str, object]
) -> tuple[list[PaperRow], list[str]]:
    """The rows of a scene, and a note for each reason why some may not stand beside runs with these settings."""
    found = [row for row in paper if row.scene.lower() == _plain(scene) and row.views == views]
    kept, notes = [], dict[str, None]()
    for row in found:
        different = [
            f"{key}={settings[key]}"
            for key, allowed in PROTOCOLS.get(row.dataset, {}).items()
            if key in settings and settings[key] not in allowed
        ]
        if different:
            notes[
                f"The paper's rows are left out, because the runs have {', '.join(different)}."
            ] = None
        else:
            kept.append(row)
    return kept, list(notes)


def published(
    paper: Sequence[PaperRow], setting: Setting, runs: Sequence[RunRecord]
) -> tuple[list[PaperRow], list[str]]:
    """What was published on the scene of some runs, see `rows_of_scene`; nothing on held-out training views."""
    return (
        ([], [])
        if setting.held_out
        else rows_of_scene(paper, setting.scene, setting.views, runs[0].settings)
    )


def rows_over_scenes(
    paper: Sequence[PaperRow], scenes: Sequence[Sequence[PaperRow]]
) -> list[PaperRow]:
    """Means over some scenes of methods published on all of them, each scene given by its own rows.

    Where these are all scenes of a data set, its published means, which know more methods, come instead.
    """
    datasets = {(row.dataset, row.views) for rows in scenes for row in rows}
    if not all(scenes) or not datasets:
        return []
    if len(datasets) == 1:
        of_dataset = [row for row in paper if (row.dataset, row.views) in datasets]
        if {row.scene for row in of_dataset} - {MEAN} == {
            row.scene for rows in scenes for row in rows
        }:
            published = [row for row in of_dataset if row.scene == MEAN]
            if published:
                return published
    by_scene = [{row.method: with_average(row) for row in rows} for rows in scenes]
    return [
        _mean([rows[method] for rows in by_scene])
        for method in by_scene[0]
        if all(method in r for r in by_scene)
    ]


def vanilla_psnr(rows: Iterable[PaperRow]) -> float | None:
    """The published PSNR without regularizers."""
    return next((row.psnr for row in rows if row.method == VANILLA), None)


def with_average(row: PaperRow) -> PaperRow:
    """The row with `average`, the geometric mean of its errors, if it was not published."""
    if row.average is not None or row.psnr is None or row.ssim is None or row.lpips is None:
        return row
    return replace(
        row, average=math.cbrt(10 ** (-row.psnr / 10) * math.sqrt(1 - row.ssim) * row.lpips)
    )


def _mean(rows: Sequence[PaperRow]) -> PaperRow:
    def mean(name: str) -> float | None:
        values = [getattr(row, name) for row in rows]
        return None if None in values else statistics.fmean(values)

    first, (psnr, ssim, lpips, average) = rows[0], map(mean, VALUES)
    return PaperRow(first.dataset, first.views, MEAN, first.method, psnr, ssim, lpips, average)


def _plain(scene: str) -> str:
    """Without what sets apart runs of one scene: `chair (factor=8)` is chair."""
    return scene.partition(" (")[0].lower()


def _row(path: Path, number: int, line: Mapping[str, str | None]) -> PaperRow:
    def value(column: str) -> float | None:
        text = (line[column] or "").strip()
        if not text:
            return None
        try:
            return float(text)
        except ValueError:
            raise NerfregError(f"{path}, line {number}: {column}={text} is no number") from None

    views = (line["views"] or "").strip()
    if not views.isdecimal():
        raise NerfregError(f"{path}, line {number}: views={views} is no whole number")
    dataset, scene, method = (
        (line[column] or "").strip() for column in ("dataset", "scene", "method")
    )
    psnr, ssim, lpips, average = map(value, VALUES)
    return PaperRow(dataset, int(views), scene, method, psnr, ssim, lpips, average)
