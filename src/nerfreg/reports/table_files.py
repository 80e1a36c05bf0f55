"""Tables as Markdown, LaTeX and CSV. The same runs give the same bytes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from nerfreg.files import write_csv, write_text
from nerfreg.reports.records import NamedRun, Setting
from nerfreg.reports.tables import Table, TableCell
from nerfreg.reports.templates import template
from nerfreg.reports.timing import seconds_to_psnr
from nerfreg.runs.records import METRICS

LEGEND = "Bold: best. Italic: second best. ±: standard deviation."
AVERAGED = (*METRICS, "train_seconds", "million_points_per_second", "seconds_to_psnr")


def write_tables(runs: Sequence[NamedRun], tables: Sequence[Table], folder: Path) -> list[Path]:
    """Write tables.md with all tables, tables/NAME.tex with one each, methods.csv and runs.csv.

    Raises:
        NerfregError: A file cannot be written.
    """
    texts = {folder / "tables.md": markdown(tables)}
    texts |= {folder / "tables" / f"{table.name}.tex": latex(table) for table in tables}
    for path, text in texts.items():
        write_text(path, text)
    lines = {"methods.csv": [*_method_lines(tables)], "runs.csv": [*_run_lines(runs, tables)]}
    for name, content in lines.items():
        write_csv(
            folder / name, list(content[0]), ([*map(_value, line.values())] for line in content)
        )
    return [*texts, *(folder / name for name in lines)]


def markdown(tables: Sequence[Table]) -> str:
    """Return tables with their headings, and their notes as lists."""
    marked = any(cell.best for table in tables for row in table.rows for cell in row.cells)
    return template("tables.md.j2").render(tables=tables, legend=LEGEND if marked else "")


def latex(table: Table) -> str:
    """Return a float for the package booktabs; the paper's rows stand below a rule."""
    return template("table.tex.j2").render(table=table)


def _method_lines(tables: Sequence[Table]) -> Iterator[dict[str, object]]:
    """Yield one line for each method and scene, the paper's included."""
    for table in tables:
        for row in table.rows if table.setting else ():
            keys = (column.key for column in table.columns)
            cells = {key: TableCell() for key in AVERAGED} | dict(zip(keys, row.cells, strict=True))
            timed = cells["seconds_to_psnr"]
            numbers: dict[str, object] = {}
            for key in AVERAGED:
                numbers[f"{key}_mean"] = cells[key].value
                numbers[f"{key}_std"] = cells[key].spread
                numbers[f"{key}_n"] = cells[key].count or None
            yield {
                **_about(table.setting),
                "method": row.label.removesuffix(" (paper)") if row.paper else row.label,
                "source": "paper" if row.paper else "runs",
                "n": row.counted,
                **numbers,
                "psnr_to_reach": table.target,
                "reached": "at most" if timed.at_most else timed.text,
            }


def _run_lines(runs: Sequence[NamedRun], tables: Sequence[Table]) -> Iterator[dict[str, object]]:
    """Yield one line for each run, failed and incomplete ones included."""
    targets = {table.setting: table.target for table in tables if table.setting}
    for run in runs:
        target = targets.get(run.setting)
        crossing = None if target is None else seconds_to_psnr(run.evaluations, target)
        yield {
            **_about(run.setting),
            "method": run.method,
            "seed": run.seed,
            "state": run.state,
            **{key: getattr(run.last, key, None) for key in ("step", "train_seconds", *METRICS)},
            "psnr_to_reach": target,
            "seconds_to_psnr": crossing and crossing.seconds,
            "points_per_second": run.points_per_second,
            "peak_memory_mb": run.peak_memory_mb,
            "threads": run.threads,
            "failure": run.failure,
            "folder": run.folder.as_posix(),
            "overrides": " ".join(run.command),
        }


def _about(setting: Setting | None) -> dict[str, object]:
    assert setting is not None
    scored = "held-out" if setting.held_out else "test"
    return {"scene": setting.scene, "views": setting.views, "scored": scored}


def _value(value: object) -> object:
    """Return a number with six digits; what is not known is empty."""
    return format(value, ".6g") if isinstance(value, float) else value
