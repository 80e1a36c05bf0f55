"""Methods x scores: a table for each scene and for each set of scenes, and what a step costs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from nerfreg.reports.paper import PaperRow, published, rows_over_scenes, vanilla_psnr
from nerfreg.reports.records import (
    NamedRun,
    Setting,
    by_method,
    by_setting,
    complete,
    counted,
    slug,
)
from nerfreg.reports.tables import Column, Row, Table, TableCell, marked, mean_of, mean_over_scenes
from nerfreg.reports.timing import mean_seconds_to_psnr

SCORES = (
    Column("PSNR", "dB", ".2f", "up", "psnr"),
    Column("SSIM", "", ".3f", "up", "ssim"),
    Column("LPIPS", "", ".3f", "down", "lpips"),
    Column("average", "", ".3f", "down", "average"),
)
MEASURED = "metrics."
"""Beginning of the keys of columns that plugins have measured."""
DEPTH = Column("depth RMSE", "", ".3f", "down", "depth_rmse")
TRAIN = Column("train", "s", ".0f", "down", "train_seconds")
SPEED = Column("points", "M/s", ".2f", "up", "million_points_per_second")
REACHED = Column("to a PSNR", "s", ".0f", "down", "seconds_to_psnr")
SUBSET_NOTE = (
    "Seconds to a PSNR are of training, read off the evaluations of each run, linear in the "
    "logarithm of time between two of them. Those before the last one score a subset of the views "
    "and of their pixels."
)
AVERAGE_NOTE = "Averages that the paper does not give are computed from its PSNR, SSIM and LPIPS."


@dataclass(frozen=True)
class _Scene:
    """A scene's runs, what was published on it, and the PSNR whose time is wanted."""

    setting: Setting
    runs: list[NamedRun]
    paper: list[PaperRow]
    target: float | None
    notes: list[str]

    @property
    def shared(self) -> str:
        return ", ".join(self.runs[0].shared)


def comparisons(
    runs: Sequence[NamedRun],
    paper: Sequence[PaperRow] = (),
    psnr: float | None = None,
    notes: Mapping[Setting, Sequence[str]] | None = None,
) -> list[Table]:
    """Return a table for each scene, then those over scenes.

    Args:
        runs: One for each setting, method and seed.
        paper: What was published.
        psnr: Whose time is asked for; None: the published one of vanilla, where there is one.
        notes: What else is to be said under the table of a setting.
    """
    scenes = []
    for setting, own in by_setting(runs).items():
        rows, remarks = published(paper, setting, own[0].settings)
        target = vanilla_psnr(rows) if psnr is None else psnr
        remarks += (notes or {}).get(setting, ())
        scenes.append(_Scene(setting, own, rows, target, remarks))
    over = [_over_scenes(family, group, paper) for family, group in _families(scenes)]
    over = [table for table in over if any(not row.paper for row in table.rows)]
    return [*map(_of_scene, scenes), *over]


def _of_scene(scene: _Scene) -> Table:
    columns = _columns([scene], None if scene.target is None else f"to {scene.target:g} dB")
    methods = by_method(scene.runs).items()
    rows = [_row(method, [(scene, complete(runs))], columns) for method, runs in methods]
    notes = [f"All runs: {scene.shared}."] if scene.shared else []
    notes += [_left_out(run) for run in scene.runs if run.final is None]
    notes += [
        f"{column.name} of {row.label}: from {cell.count} of {row.count} runs."
        for row in rows
        for column, cell in zip(columns, row.cells, strict=True)
        if 0 < cell.count < row.count
    ]
    notes += [*scene.notes, *_notes_on_columns(columns, [scene], scene.paper)]
    rows += [_paper_row(row, columns) for row in scene.paper]
    title, name = scene.setting.title, scene.setting.name
    table = Table(title, name, columns, marked(columns, rows), notes=tuple(notes))
    return replace(table, setting=scene.setting, target=scene.target)


def _over_scenes(family: str, scenes: Sequence[_Scene], paper: Sequence[PaperRow]) -> Table:
    timed = all(scene.target is not None for scene in scenes)
    columns = _columns(scenes, "to PSNR" if timed else None)
    done = [(scene, by_method(complete(scene.runs))) for scene in scenes]
    rows: list[Row] = []
    incomplete: dict[str, list[str]] = {}
    for method in by_method(run for scene in scenes for run in scene.runs):
        known = [(scene, methods[method]) for scene, methods in done if method in methods]
        if len(known) == len(scenes):
            rows.append(_row(method, known, columns))
        else:
            lacking = [scene.setting.title for scene, methods in done if method not in methods]
            incomplete.setdefault("; ".join(lacking), []).append(method)
    means = rows_over_scenes(paper, [scene.paper for scene in scenes])
    notes = [
        f"Left out, without a complete run on {where}: {', '.join(methods)}."
        for where, methods in incomplete.items()
    ]
    if len({scene.shared for scene in scenes}) > 1:
        notes += [f"{s.setting.title}: all runs have {s.shared or 'no override'}." for s in scenes]
    if timed:
        targets = ", ".join(f"{s.setting.scene} {s.target:g} dB" for s in scenes)
        notes.append(f"PSNR to reach: {targets}.")
    notes.append(
        f"Means over {', '.join(scene.setting.scene for scene in scenes)} of the means over seeds; "
        "± is the standard deviation of a mean over one run of each scene."
    )
    notes += _notes_on_columns(columns, scenes, means)
    rows += [_paper_row(row, columns) for row in means]
    title, name = f"Mean over {family}", slug(f"mean {family}")
    return Table(title, name, columns, marked(columns, rows), "runs", tuple(notes))


def _families(scenes: Sequence[_Scene]) -> list[tuple[str, list[_Scene]]]:
    """Return the sets of scenes to average over, with their titles.

    They are those of one format with as many views, then all, if each has one number of views.
    """
    groups: dict[tuple[str, int, bool], list[_Scene]] = {}
    for scene in scenes:
        form = str(scene.runs[0].settings.get("scene.format", "unknown"))
        groups.setdefault((form, scene.setting.views, scene.setting.held_out), []).append(scene)
    families = []
    for (form, views, held_out), group in groups.items():
        ending = ", held-out training views" if held_out else ""
        title = f"{len(group)} {form} scenes, {counted(views, 'view')}{ending}"
        families += [(title, group)] if len(group) > 1 else []
    tested = [scene for scene in scenes if not scene.setting.held_out]
    several = sum(not held_out for *_, held_out in groups) > 1
    if several and len({scene.setting.scene for scene in tested}) == len(tested):
        families.append((f"all {len(tested)} scenes", tested))
    return families


def _columns(scenes: Sequence[_Scene], timed: str | None) -> tuple[Column, ...]:
    """Return the columns: depth errors only where the depth of every scene is known.

    What plugins measured has a column where every scene has a run with that plugin. `timed` is the
    heading of seconds to a PSNR, if they are wanted.
    """
    finals = [[run.final for run in scene.runs if run.final] for scene in scenes]
    longest = max((final.train_seconds for own in finals for final in own), default=0.0)
    digits = ".0f" if longest >= 100 else ".1f" if longest >= 10 else ".3f"
    deep = all(any(final.depth_rmse is not None for final in own) for own in finals)
    reached = [replace(REACHED, name=timed, format=digits)] if timed else []
    names = [dict.fromkeys(name for final in own for name in final.metrics) for own in finals]
    # A plugin does not say which direction is better, so that none is marked.
    measured = [
        Column(name, "", ".3g", None, MEASURED + name)
        for name in (names[0] if names else ())
        if all(name in own for own in names)
    ]
    costs = (replace(TRAIN, format=digits), SPEED, *reached)
    return (*SCORES, *[DEPTH][: int(deep)], *measured, *costs)


def _row(
    method: str, known: Sequence[tuple[_Scene, list[NamedRun]]], columns: Sequence[Column]
) -> Row:
    cells = ([_cell(column, runs, scene.target) for scene, runs in known] for column in columns)
    return Row(method, tuple(map(mean_over_scenes, cells)), sum(len(runs) for _, runs in known))


def _cell(column: Column, runs: Sequence[NamedRun], target: float | None) -> TableCell:
    if column.key == REACHED.key:
        return mean_seconds_to_psnr(runs, target or 0.0)
    return mean_of(_value(column, run) for run in runs)


def _value(column: Column, run: NamedRun) -> float | None:
    if column.key == SPEED.key:
        return None if run.points_per_second is None else run.points_per_second / 1e6
    if column.key.startswith(MEASURED):
        return run.final.metrics.get(column.key.removeprefix(MEASURED)) if run.final else None
    return getattr(run.final, column.key, None)


def _paper_row(row: PaperRow, columns: Sequence[Column]) -> Row:
    cells = tuple(TableCell(getattr(row, column.key, None)) for column in columns)
    return Row(f"{row.method} (paper)", cells, paper=True)


def _left_out(run: NamedRun) -> str:
    """Return why a run is not in the means."""
    unfinished = f"is not complete and not in the means: {run.progress}"
    problem = unfinished if run.failure is None else f"failed: {run.failure}"
    return f"{run.method}, seed {run.seed}, {problem} ({run.folder})"


def _notes_on_columns(
    columns: Sequence[Column], scenes: Iterable[_Scene], paper: Iterable[PaperRow]
) -> list[str]:
    runs = [run for scene in scenes for run in complete(scene.runs)]
    timed = columns[-1].key == REACHED.key
    on_subsets = timed and any(not each.whole for run in runs for each in run.evaluations)
    computed = any(row.computed for row in paper)
    return [SUBSET_NOTE] * on_subsets + [AVERAGE_NOTE] * computed
