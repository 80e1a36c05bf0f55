"""`nerfreg report RUNS... [-o FOLDER] [--paper FILE] [--psnr DB] [--views NAME,NAME]`."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from nerfreg.errors import NerfregError, nearest
from nerfreg.reports.tables import Table

OPTIONS = {
    "-o": "a folder to write to: -o FOLDER",
    "--paper": "a CSV file of published numbers: --paper FILE",
    "--psnr": "a PSNR in dB: --psnr 25",
    "--views": "names of test views, separated by commas: --views image000,image008",
}
NAME_WIDTH, PIPE_WIDTH = 24, 160


@dataclass(frozen=True)
class ReportOptions:
    """runs: folders of runs, or above them. folder: where the report goes. paper: published numbers.

    psnr: the PSNR to which training is timed; None: the published one of vanilla. pictures: views to show.
    """

    runs: tuple[Path, ...]
    folder: Path = Path("report")
    paper: Path | None = None
    psnr: float | None = None
    pictures: tuple[str, ...] = ()


def run(words: Sequence[str]) -> int:
    """Write the report on some runs, print its main table; returns the exit code.

    Raises NerfregError for unknown options, and where there is no run or nothing can be read or written.
    """
    options = parse_report_options(words)
    from nerfreg.reports import figures, page
    from nerfreg.reports.collect import collect
    from nerfreg.reports.comparison import comparisons, cost_tables
    from nerfreg.reports.paper import read_paper
    from nerfreg.reports.pictures import compare
    from nerfreg.reports.statistics import without_repetitions
    from nerfreg.reports.table_files import write_tables

    paper = read_paper(options.paper) if options.paper else []
    records, notes = without_repetitions(collect(options.runs))
    compared = comparisons(records, paper, options.psnr, notes)
    tables = [*compared, *cost_tables(records)]
    # First, because it refuses views that nobody has: then nothing is written.
    pictures = compare(records, options.pictures)
    plots = figures.plots(records, paper)
    paths = [
        *write_tables(records, tables, options.folder),
        *figures.draw(plots, options.folder),
        page.write(records, tables, plots, pictures, options.folder),
    ]
    over_scenes = [table for table in compared if table.setting is None]
    for table in over_scenes or compared:
        print_table(table)
    for path in paths:
        print(path)
    return 0


def parse_report_options(words: Sequence[str]) -> ReportOptions:
    """Read what follows `nerfreg report`. Raises NerfregError naming the word at fault."""
    given: dict[str, str] = {}
    runs, rest = list[Path](), list(words)
    while rest:
        word = rest.pop(0)
        if word in OPTIONS:
            if not rest or rest[0] in OPTIONS:
                raise NerfregError(f"{word} needs {OPTIONS[word]}")
            given[word] = rest.pop(0)
        elif word.startswith("-"):
            raise NerfregError(f"report: unknown option '{word}'; {nearest(word, OPTIONS)}")
        else:
            runs.append(Path(word))
    if not runs:
        raise NerfregError("report needs folders of runs: nerfreg report RUNS...")
    folder = Path(given.get("-o", ReportOptions.folder))
    if folder.exists() and not folder.is_dir():
        raise NerfregError(f"-o {folder}: is a file; name a folder")
    return ReportOptions(
        tuple(runs),
        folder,
        Path(given["--paper"]) if "--paper" in given else None,
        _decibels(given["--psnr"]) if "--psnr" in given else None,
        tuple(name for name in given.get("--views", "").split(",") if name),
    )


def print_table(table: Table) -> None:
    """The table and its notes on the terminal: best bold, second best underlined."""
    from rich import box
    from rich.console import Console
    from rich.table import Table as Grid
    from rich.text import Text

    grid = Grid(
        title=table.title, box=box.SIMPLE_HEAD, pad_edge=False, padding=0, title_justify="left"
    )
    grid.add_column(
        "method",
        overflow="fold",
        min_width=min(max(len(row.label) for row in table.rows), NAME_WIDTH),
    )
    for heading in (
        *(column.heading.replace(" ", "\n", 1) for column in table.columns),
        table.counted,
    ):
        grid.add_column(heading, justify="right")
    for row in table.rows:
        cells = [
            Text(cell.shown(column), "bold" if cell.best else "underline" if cell.second else "")
            for column, cell in zip(table.columns, row.cells, strict=True)
        ]
        count = Text("" if row.paper else str(row.count))
        grid.add_row(Text(row.label), *cells, count, style="dim" if row.paper else None)
    # What is piped has no width of its own.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else PIPE_WIDTH)
    console.print(grid)
    for note in table.notes:
        console.print(Text(f"  {note}"))
    console.print()


def _decibels(word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise NerfregError(f"--psnr {word}: must be a number of decibels, e.g. --psnr 25")
    return value
