"""Published numbers, from a CSV file, beside those of runs."""

from __future__ import annotations

import csv
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from nerfreg.errors import NerfregError
from nerfreg.reports.records import VANILLA, Setting

KEYS = ("dataset", "views", "scene", "method")
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
"""Settings under which published numbers of a data set may stand beside ours.

The name of a scene alone says little.
"""


@dataclass(frozen=True)
class PaperRow:
    """A method on a scene as it was published; None for what was not."""

    dataset: str
    views: int
    scene: str
    method: str
    psnr: float | None = None
    ssim: float | None = None
    lpips: float | None = None
    average: float | None = None
    computed: bool = False


def read_paper(path: Path) -> list[PaperRow]:
    """Return the rows of a CSV file with at least the columns `KEYS` and `VALUES`.

    Rows that several of the paper's tables repeat are merged. Averages that were not published are
    computed.

    Raises:
        NerfregError: What cannot be read, by file, line and column.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            columns = (*KEYS, *VALUES)
            missing = [column for column in columns if column not in (reader.fieldnames or ())]
            if missing:
                needed = f"needed: {', '.join(columns)}"
                raise NerfregError(f"{path}: no column {', '.join(missing)}; {needed}")
            rows = [_row(f"{path}, line {reader.line_num}", line) for line in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise NerfregError(f"--paper {path}: cannot be read ({reason})") from error
    merged: dict[tuple[object, ...], PaperRow] = {}
    for row in rows:
        key = tuple(getattr(row, name) for name in KEYS)
        before = merged.setdefault(key, row)
        gaps = {name: getattr(row, name) for name in VALUES if getattr(before, name) is None}
        merged[key] = replace(before, **gaps)
    return [with_average(row) for row in merged.values()]


def published(
    paper: Sequence[PaperRow], setting: Setting, settings: Mapping[str, Any]
) -> tuple[list[PaperRow], list[str]]:
    """Return what was published in a setting, and notes on what may not stand beside its runs.

    Nothing was published on held-out training views. `settings` is the configuration of the runs.
    """
    # Without what sets apart runs of one scene: `chair (factor=8)` is chair.
    scene = setting.scene.partition(" (")[0].lower()
    kept, notes = [], dict[str, None]()
    for row in () if setting.held_out else paper:
        if (row.scene.lower(), row.views) != (scene, setting.views):
            continue
        different = [
            f"{key}={settings[key]}"
            for key, allowed in PROTOCOLS.get(row.dataset, {}).items()
            if key in settings and settings[key] not in allowed
        ]
        if different:
            reason = f"the runs have {', '.join(different)}"
            notes[f"The paper's rows are left out, because {reason}."] = None
        else:
            kept.append(row)
    return kept, list(notes)


def rows_over_scenes(
    paper: Sequence[PaperRow], scenes: Sequence[Sequence[PaperRow]]
) -> list[PaperRow]:
    """Return means over some scenes of the methods that were published on all of them.

    Where these are all scenes of a data set, its published means, which know more methods, come
    instead. `scenes` has the rows of each scene.
    """
    datasets = {(row.dataset, row.views) for rows in scenes for row in rows}
    if not all(scenes) or not datasets:
        return []
    if len(datasets) == 1:
        known = [row for row in paper if (row.dataset, row.views) in datasets]
        means = [row for row in known if row.scene == MEAN]
        ours = {row.scene for rows in scenes for row in rows}
        if means and {row.scene for row in known} - {MEAN} == ours:
            return means
    by_scene = [{row.method: row for row in rows} for rows in scenes]
    common = [method for method in by_scene[0] if all(method in rows for rows in by_scene)]
    return [_mean([rows[method] for rows in by_scene]) for method in common]


def vanilla_psnr(rows: Iterable[PaperRow]) -> float | None:
    """Return the published PSNR without regularizers."""
    return next((row.psnr for row in rows if row.method == VANILLA), None)


def with_average(row: PaperRow) -> PaperRow:
    """Return the row with `average`, the geometric mean of its errors, if it has none."""
    if row.average is not None or row.psnr is None or row.ssim is None or row.lpips is None:
        return row
    average = math.cbrt(10 ** (-row.psnr / 10) * math.sqrt(1 - row.ssim) * row.lpips)
    return replace(row, average=average, computed=True)


def _mean(rows: Sequence[PaperRow]) -> PaperRow:
    columns = {name: [getattr(row, name) for row in rows] for name in VALUES}
    means: dict[str, Any] = {
        k: None if None in v else statistics.fmean(v) for k, v in columns.items()
    }
    return replace(rows[0], scene=MEAN, computed=False, **means)


def _row(place: str, line: Mapping[str, str | None]) -> PaperRow:
    texts = {name: (line[name] or "").strip() for name in (*KEYS, *VALUES)}
    if not texts["views"].isdecimal():
        raise NerfregError(f"{place}: views={texts['views']} is no whole number")
    values: dict[str, Any] = {}
    for name in VALUES:
        try:
            values[name] = float(texts[name]) if texts[name] else None
        except ValueError:
            raise NerfregError(f"{place}: {name}={texts[name]} is no number") from None
    keys = texts["dataset"], int(texts["views"]), texts["scene"], texts["method"]
    return PaperRow(*keys, **values)
