"""Tables as Markdown, LaTeX and CSV files. What they say depends on runs alone: the same runs give the same bytes."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from nerfreg.files import atomic
from nerfreg.reports.grouping import Setting
from nerfreg.reports.records import METRICS, RunRecord
from nerfreg.reports.tables import Cell, Column, Row, Table
from nerfreg.reports.timing import seconds_to_psnr

LATEX = {
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}",
    ">": r"\textgreater{}", "|": r"\textbar{}", "±": r"$\pm$", "≤": r"$\le$", "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
}  # fmt: skip
LEGEND = "Bold: best. Italic: second best. ±: standard deviation."
STATISTICS = (*METRICS, "train_seconds", "million_points_per_second", "seconds_to_psnr")


def write_tables(records: Sequence[RunRecord], tables: Sequence[Table], folder: Path) -> list[Path]:
    """tables.md with all tables, tables/NAME.tex with one each, methods.csv and runs.csv; returns their paths.

    Raises NerfregError where they cannot be written.
    """
    legend = (
        [LEGEND]
        if any(cell.best for table in tables for row in table.rows for cell in row.cells)
        else []
    )
    paths = [_write(folder / "tables.md", "\n\n".join([*legend, *map(markdown, tables)]) + "\n")]
    paths += [_write(folder / "tables" / f"{table.name}.tex", latex(table)) for table in tables]
    paths.append(_write_csv(folder / "methods.csv", _method_lines(tables)))
    paths.append(_write_csv(folder / "runs.csv", _run_lines(records, tables)))
    return paths


def markdown(table: Table) -> str:
    """A heading, the table, and its notes as a list."""
    columns = ["method", *(column.heading for column in table.columns), table.counted]
    lines = [
        f"## {_markdown_text(table.title)}",
        "",
        _markdown_line(columns),
        _markdown_line([":--", *("--:" for _ in columns[1:])]),
        *(
            _markdown_line(
                [
                    _markdown_text(row.label),
                    *map(_markdown_cell, row.cells, table.columns),
                    "" if row.paper else str(row.count),
                ]
            )
            for row in table.rows
        ),
        *([""] if table.notes else []),
        *(f"- {_markdown_text(note)}" for note in table.notes),
    ]
    return "\n".join(lines)


def latex(table: Table) -> str:
    """A float for the package booktabs; the paper's rows stand below a rule."""
    heading = ["method", *(column.heading for column in table.columns), table.counted]
    runs, published = ([row for row in table.rows if row.paper is paper] for paper in (False, True))
    body = [*(_latex_row(row, table.columns) for row in runs)]
    if published:
        body += [r"\midrule", *(_latex_row(row, table.columns) for row in published)]
    notes = [r"\par\smallskip\footnotesize", *(f"{latex_text(note)}\\par" for note in table.notes)]
    lines = [
        r"% \usepackage{booktabs}",
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{latex_text(table.title)}}}",
        rf"\label{{tab:{table.name}}}",
        rf"\begin{{tabular}}{{l{'r' * (len(heading) - 1)}}}",
        r"\toprule",
        " & ".join(map(latex_text, heading)) + r" \\",
        r"\midrule",
        *body,
        r"\bottomrule",
        r"\end{tabular}",
        *(notes if table.notes else []),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def latex_text(text: str) -> str:
    """Text that means itself in LaTeX."""
    return "".join(LATEX.get(letter, letter) for letter in text)


def _latex_row(row: Row, columns: Sequence[Column]) -> str:
    cells = [
        latex_text(row.label),
        *map(_latex_cell, row.cells, columns),
        "" if row.paper else str(row.count),
    ]
    return " & ".join(cells) + r" \\"


def _latex_cell(cell: Cell, column: Column) -> str:
    mean, plus_minus, spread = cell.shown(column).partition(" ± ")
    mean, spread = latex_text(mean), latex_text(plus_minus + spread)
    return (
        rf"\textbf{{{mean}}}" if cell.best else rf"\underline{{{mean}}}" if cell.second else mean
    ) + spread


def _markdown_cell(cell: Cell, column: Column) -> str:
    shown = cell.shown(column)
    return f"**{shown}**" if cell.best else f"*{shown}*" if cell.second else shown


def _markdown_line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _markdown_text(text: str) -> str:
    """Text that means itself in Markdown, in a cell too."""
    return re.sub(r"([\\|*<>\[\]`])", r"\\\1", text)


def _method_lines(tables: Sequence[Table]) -> list[dict[str, object]]:
    """One line for each method and scene, the paper's included."""
    lines = []
    for table in tables:
        for row in table.rows if table.setting else ():
            line = {
                **_about(table.setting),
                "method": row.label.removesuffix(" (paper)") if row.paper else row.label,
            }
            line |= {
                "source": "paper" if row.paper else "runs",
                "n": "" if row.paper else row.count,
            }
            cells = {
                column.key: cell for column, cell in zip(table.columns, row.cells, strict=True)
            }
            for key in STATISTICS:
                cell = cells.get(key, Cell(None))
                line |= {
                    f"{key}_mean": cell.value,
                    f"{key}_std": cell.spread,
                    f"{key}_n": cell.count or None,
                }
            timed = cells.get("seconds_to_psnr", Cell(None))
            line |= {
                "psnr_to_reach": table.target,
                "reached": "at most" if timed.at_most else timed.text,
            }
            lines.append(line)
    return lines


def _run_lines(records: Sequence[RunRecord], tables: Sequence[Table]) -> list[dict[str, object]]:
    """One line for each run, failed and incomplete ones included."""
    targets = {table.setting: table.target for table in tables if table.setting}
    lines = []
    for record in records:
        setting = Setting(record.scene, record.views, record.held_out)
        state = (
            "failed" if record.failure is not None else "complete" if record.final else "incomplete"
        )
        line: dict[str, object] = {
            **_about(setting),
            "method": record.method,
            "seed": record.seed,
            "state": state,
        }
        last = record.evaluations[-1] if record.evaluations else None
        line |= {"step": last and last.step, "train_seconds": last and last.train_seconds}
        line |= {metric: last and getattr(last, metric) for metric in METRICS}
        target = targets.get(setting)
        crossing = None if target is None else seconds_to_psnr(record.evaluations, target)
        line |= {"psnr_to_reach": target, "seconds_to_psnr": crossing and crossing.seconds}
        line |= {
            "points_per_second": record.points_per_second,
            "peak_memory_mb": record.peak_memory_mb,
        }
        line |= {
            "threads": record.threads,
            "failure": record.failure,
            "folder": record.folder.as_posix(),
        }
        lines.append({**line, "overrides": " ".join(record.command)})
    return lines


def _about(setting: Setting | None) -> dict[str, object]:
    assert setting is not None
    return {
        "scene": setting.scene,
        "views": setting.views,
        "scored": "held-out" if setting.held_out else "test",
    }


def _write(path: Path, text: str) -> Path:
    with atomic(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")
    return path


def _write_csv(path: Path, lines: Sequence[dict[str, object]]) -> Path:
    """Numbers with six digits; what is not known is empty."""
    with atomic(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(lines[0]), lineterminator="\n")
        writer.writeheader()
        for line in lines:
            writer.writerow(
                {
                    key: format(value, ".6g") if isinstance(value, float) else value
                    for key, value in line.items()
                }
            )
    return path
