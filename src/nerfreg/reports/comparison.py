"""Methods x scores: one table for each scene, one for each set of scenes, and what a step of each method costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nerfreg.reports.columns import (
    AVERAGE,
    LPIPS,
    PSNR,
    REACHED,
    RELATIVE,
    SSIM,
    STEP,
    cell_of,
    columns_of,
    statistic_of,
)
from nerfreg.reports.grouping import Setting, by_setting, slug
from nerfreg.reports.methods import VANILLA
from nerfreg.reports.paper import PaperRow, published, rows_over_scenes, vanilla_psnr, with_average
from nerfreg.reports.records import RunRecord
from nerfreg.reports.statistics import (
    Statistic,
    complete,
    mean_of_means,
    ordered_methods,
    summarize,
)
from nerfreg.reports.tables import NOT_REACHED, Cell, Column, Row, Table, marked
from nerfreg.reports.timing import Cost, costs, seconds_to_psnr

SUBSET_NOTE = (
    "Seconds to a PSNR are of training, read off the evaluations of each run, linear in the logarithm of time between "
    "two of them. Those before the last one score a subset of the views and of their pixels."
)
AVERAGE_NOTE = "Averages that the paper does not give are computed from its PSNR, SSIM and LPIPS."


@dataclass(frozen=True)
class _Scene:
    """A scene's runs, what was published on it, and the PSNR whose time is wanted."""

    setting: Setting
    runs: list[RunRecord]
    paper: list[PaperRow]
    target: float | None
    notes: list[str]


def comparisons(
    records: Sequence[RunRecord],
    paper: Sequence[PaperRow] = (),
    psnr: float | None = None,
    notes: Mapping[Setting, Sequence[str]] | None = None,
) -> list[Table]:
    """A table for each scene, then those over scenes.

    psnr: whose time is asked for; None: the published one of vanilla, where there is one.
    notes: what else is to be said under the table of a scene.
    """
    scenes = []
    for setting, runs in by_setting(records).items():
        rows, remarks = published(paper, setting, runs)
        target = vanilla_psnr(rows) if psnr is None else psnr
        scenes.append(
            _Scene(setting, runs, rows, target, [*remarks, *(notes or {}).get(setting, ())])
        )
    over = [_over_scenes(title, group, paper) for title, group in _families(scenes)]
    return [
        *map(_of_scene, scenes),
        *(table for table in over if any(not row.paper for row in table.rows)),
    ]


def cost_tables(records: Sequence[RunRecord]) -> list[Table]:
    """What a step takes, for each scene that has more than one method."""
    tables = []
    columns = (STEP, RELATIVE)
    by_scene: dict[Setting, list[Cost]] = {}
    for cost in costs(records):
        by_scene.setdefault(cost.setting, []).append(cost)
    for setting, found in by_scene.items():
        if len({cost.method for cost in found}) < 2:
            continue
        several = len({cost.threads for cost in found}) > 1
        rows = [
            Row(
                f"{cost.method}, {_threads(cost.threads)}"
                if several and "threads=" not in cost.method
                else cost.method,
                (
                    Cell(1e3 * cost.seconds_per_step, count=cost.runs),
                    Cell(cost.relative, count=cost.runs),
                ),
                cost.runs,
            )
            for cost in sorted(found, key=lambda cost: cost.seconds_per_step)
        ]
        notes = [
            "Medians over runs. Vanilla has the same settings and threads, and a budget of the same kind."
        ]
        if not several:
            notes.append(f"Trained with {_threads(found[0].threads)}.")
        title = f"Cost of a step: {setting.title}"
        tables.append(
            Table(
                title, f"cost-{setting.name}", columns, marked(columns, rows), "runs", tuple(notes)
            )
        )
    return tables


def _of_scene(scene: _Scene) -> Table:
    columns = columns_of([scene.runs], None if scene.target is None else f"to {scene.target:g} dB")
    rows = []
    for method, runs in ordered_methods(scene.runs, VANILLA).items():
        done = complete(runs)
        cells = [
            cell_of(statistic_of(column, done)) for column in columns if column.key != REACHED.key
        ]
        if scene.target is not None:
            cells.append(_reached(done, scene.target))
        rows.append(Row(method, tuple(cells), len(done)))
    rows += [_paper_row(row, columns) for row in scene.paper]
    notes = [*_notes_on_runs(scene.runs), *_fewer(columns, rows, "runs"), *scene.notes]
    return Table(
        scene.setting.title,
        scene.setting.name,
        columns,
        marked(columns, rows),
        "seeds",
        (*notes, *_notes_on_columns(scene.target is not None, scene.runs, scene.paper)),
        scene.setting,
        scene.target,
    )


def _over_scenes(title: str, scenes: Sequence[_Scene], paper: Sequence[PaperRow]) -> Table:
    timed = all(scene.target is not None for scene in scenes)
    columns = columns_of([scene.runs for scene in scenes], "to PSNR" if timed else None)
    done = [ordered_methods(complete(scene.runs), VANILLA) for scene in scenes]
    methods = ordered_methods([run for scene in scenes for run in scene.runs], VANILLA)
    rows: list[Row] = []
    incomplete: dict[str, list[str]] = {}
    for method in methods:
        lacking = [
            scene.setting.title
            for scene, runs in zip(scenes, done, strict=True)
            if method not in runs
        ]
        if lacking:
            incomplete.setdefault("; ".join(lacking), []).append(method)
            continue
        runs = [by_method[method] for by_method in done]
        cells = [
            cell_of(mean_of_means([statistic_of(column, of_scene) for of_scene in runs]))
            for column in columns
            if column.key != REACHED.key
        ]
        if timed:
            cells.append(
                _reached_everywhere(
                    [_reached(r, s.target or 0.0) for r, s in zip(runs, scenes, strict=True)]
                )
            )
        rows.append(Row(method, tuple(cells), sum(map(len, runs))))
    known = (
        []
        if scenes[0].setting.held_out
        else rows_over_scenes(paper, [scene.paper for scene in scenes])
    )
    rows += [_paper_row(row, columns) for row in known]
    notes = [
        f"Left out, without a complete run on {where}: {', '.join(names)}."
        for where, names in incomplete.items()
    ]
    shared = {", ".join(scene.runs[0].shared) or "no override" for scene in scenes}
    if len(shared) > 1:
        notes += [
            f"{s.setting.title}: all runs have {', '.join(s.runs[0].shared) or 'no override'}."
            for s in scenes
        ]
    if timed:
        notes.append(
            "PSNR to reach: "
            + ", ".join(f"{s.setting.scene} {s.target:g} dB" for s in scenes)
            + "."
        )
    notes.append(
        f"Means over {', '.join(scene.setting.scene for scene in scenes)} of the means over seeds; ± is the standard "
        "deviation of a mean over one run of each scene."
    )
    name = slug(f"mean {title}")
    notes += _notes_on_columns(timed, [run for scene in scenes for run in scene.runs], known)
    return Table(f"Mean over {title}", name, columns, marked(columns, rows), "runs", tuple(notes))


def _families(scenes: Sequence[_Scene]) -> list[tuple[str, list[_Scene]]]:
    """Scenes to average over: those of one format with as many views, then all, if each has one number of views."""
    groups: dict[tuple[str, int, bool], list[_Scene]] = {}
    for scene in scenes:
        form = str(scene.runs[0].settings.get("scene.format", "unknown"))
        groups.setdefault((form, scene.setting.views, scene.setting.held_out), []).append(scene)
    families = []
    for (form, views, held_out), group in groups.items():
        if len(group) > 1:
            ending = ", held-out training views" if held_out else ""
            families.append(
                (f"{len(group)} {form} scenes, {views} view{'s' * (views != 1)}{ending}", group)
            )
    tested = [scene for scene in scenes if not scene.setting.held_out]
    kinds = {key for key in groups if not key[2]}
    if len(kinds) > 1 and len({scene.setting.scene for scene in tested}) == len(tested):
        families.append((f"all {len(tested)} scenes", tested))
    return families


def _reached(runs: Sequence[RunRecord], psnr: float) -> Cell:
    """Mean time to a PSNR; none where some run never gets there, for the mean of the others says too little."""
    if not runs:
        return Cell(None)
    crossings = [seconds_to_psnr(run.evaluations, psnr) for run in runs]
    times = [crossing for crossing in crossings if crossing is not None]
    if len(times) < len(runs):
        return Cell(
            None, text=NOT_REACHED if not times else f"reached by {len(times)} of {len(runs)}"
        )
    cell = cell_of(summarize(crossing.seconds for crossing in times))
    return Cell(
        cell.value, cell.spread, cell.count, at_most=any(crossing.at_most for crossing in times)
    )


def _reached_everywhere(cells: Sequence[Cell]) -> Cell:
    reached = [cell for cell in cells if cell.value is not None]
    if len(reached) < len(cells):
        return Cell(
            None,
            text=NOT_REACHED
            if not reached
            else f"reached on {len(reached)} of {len(cells)} scenes",
        )
    statistics = [Statistic(cell.value or 0.0, cell.spread, cell.count) for cell in reached]
    mean = cell_of(mean_of_means(statistics))
    return Cell(mean.value, mean.spread, mean.count, at_most=any(cell.at_most for cell in reached))


def _paper_row(row: PaperRow, columns: Sequence[Column]) -> Row:
    whole = with_average(row)
    values = {
        PSNR.key: whole.psnr,
        SSIM.key: whole.ssim,
        LPIPS.key: whole.lpips,
        AVERAGE.key: whole.average,
    }
    return Row(
        f"{row.method} (paper)",
        tuple(Cell(values.get(column.key)) for column in columns),
        paper=True,
    )


def _notes_on_runs(runs: Sequence[RunRecord]) -> list[str]:
    """What all runs share, and what is not in the means."""
    notes = [f"All runs: {', '.join(runs[0].shared)}."] if runs[0].shared else []
    for run in runs:
        who = f"{run.method}, seed {run.seed}"
        if run.failure is not None:
            notes.append(f"{who}, failed: {run.failure} ({run.folder})")
        elif run.final is None:
            last = run.evaluations[-1] if run.evaluations else None
            so_far = f"{last.train_seconds:.0f} s so far" if last else "not scored yet"
            notes.append(f"{who}, is not complete and not in the means: {so_far} ({run.folder})")
    return notes


def _fewer(columns: Sequence[Column], rows: Sequence[Row], counted: str) -> list[str]:
    """Means of fewer runs than their row's."""
    return [
        f"{column.name} of {row.label}: from {cell.count} of {row.count} {counted}."
        for row in rows
        for column, cell in zip(columns, row.cells, strict=True)
        if not row.paper and 0 < cell.count < row.count
    ]


def _notes_on_columns(
    timed: bool, runs: Sequence[RunRecord], paper: Sequence[PaperRow]
) -> list[str]:
    on_subsets = timed and any(
        not evaluation.whole for run in complete(runs) for evaluation in run.evaluations
    )
    computed = any(with_average(row) != row for row in paper)
    return [*([SUBSET_NOTE] if on_subsets else []), *([AVERAGE_NOTE] if computed else [])]


def _threads(count: int | None) -> str:
    return "threads unknown" if count is None else f"{count} thread{'s' * (count != 1)}"
