"""`nerfreg report`: everything that is written about some runs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Column
from rich.text import Text

from nerfreg.analysis.tables import build_table
from nerfreg.reports.collect import collect
from nerfreg.reports.comparison import comparisons
from nerfreg.reports.figures import draw_figures
from nerfreg.reports.page import write_page
from nerfreg.reports.paper import read_paper
from nerfreg.reports.pictures import compare
from nerfreg.reports.records import without_repetitions
from nerfreg.reports.sheet import draw_sheet
from nerfreg.reports.table_files import write_tables
from nerfreg.reports.tables import Table
from nerfreg.reports.timing import cost_tables

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
    records, repeated = without_repetitions(collect(runs))
    compared = comparisons(records, published, psnr, repeated)
    tables = [*compared, *cost_tables(records)]
    # First, because it refuses views that nobody has: then nothing is written.
    pictures, notes = compare(records, views)
    paths = write_tables(records, tables, folder)
    figures = draw_figures(records, published, folder)
    paths += figures
    for picture in pictures:
        draw_sheet(picture, folder / "pictures")
    paths.append(write_page(records, tables, figures, pictures, notes, folder))
    over_scenes = [table for table in compared if table.setting is None]
    for table in over_scenes or compared:
        print_table(table)
    print(*paths, sep="\n")


def print_table(table: Table) -> None:
    """Print a table and its notes: best bold, second best underlined."""
    width = min(max(len(row.label) for row in table.rows), NAME_WIDTH)
    names = Column(table.headings[0], overflow="fold", min_width=width)
    headings = (heading.replace(" ", "\n", 1) for heading in table.headings[1:])
    columns = [names, *(Column(heading, justify="right") for heading in headings)]
    grid = build_table(table.title, "", columns, ())
    for row in table.rows:
        cells = [
            Text(cell.shown(column), "bold" if cell.best else "underline" if cell.second else "")
            for column, cell in zip(table.columns, row.cells, strict=True)
        ]
        grid.add_row(Text(row.label), *cells, row.counted, style="dim" if row.paper else None)
    # What is piped has no width of its own.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else PIPE_WIDTH)
    console.print(grid)
    for note in table.notes:
        console.print(Text(f"  {note}"))
    console.print()
