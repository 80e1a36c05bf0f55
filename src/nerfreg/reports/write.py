"""`nerfreg report`: everything that is written about some runs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from nerfreg.reports import figures, page
from nerfreg.reports.collect import collect
from nerfreg.reports.comparison import comparisons, cost_tables
from nerfreg.reports.paper import read_paper
from nerfreg.reports.pictures import compare
from nerfreg.reports.statistics import without_repetitions
from nerfreg.reports.table_files import write_tables
from nerfreg.reports.tables import Table

NAME_WIDTH, PIPE_WIDTH = 24, 160


def write_report(
    runs: Sequence[Path],
    folder: Path,
    paper: Path | None = None,
    psnr: float | None = None,
    views: Sequence[str] = (),
) -> None:
    """Write the report on some runs, and print its main table.

    Args:
        runs: Folders of runs, or above them.
        folder: Where the report goes.
        paper: A CSV file of published numbers.
        psnr: The PSNR in dB to which training is timed; None: the published one of vanilla.
        views: Names of test views to show pictures of.

    Raises:
        NerfregError: There is no run, or something can be neither read nor written.
    """
    published = read_paper(paper) if paper else []
    records, notes = without_repetitions(collect(runs))
    compared = comparisons(records, published, psnr, notes)
    tables = [*compared, *cost_tables(records)]
    # First, because it refuses views that nobody has: then nothing is written.
    pictures = compare(records, views)
    plots = figures.plots(records, published)
    paths = [
        *write_tables(records, tables, folder),
        *figures.draw(plots, folder),
        page.write(records, tables, plots, pictures, folder),
    ]
    over_scenes = [table for table in compared if table.setting is None]
    for table in over_scenes or compared:
        print_table(table)
    for path in paths:
        print(path)


def print_table(table: Table) -> None:
    """The table and its notes on the terminal: best bold, second best underlined."""
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
