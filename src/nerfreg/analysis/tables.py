"""Tables on the terminal, made in one way by all tools."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Column, Table

from nerfreg.files import write_json


def text(*headers: str) -> list[Column]:
    """Return columns of words: aligned to the left, one line a cell."""
    return [Column(header, no_wrap=True) for header in headers]


def numbers(*headers: str) -> list[Column]:
    """Return columns of numbers: aligned to the right, one line a cell."""
    return [Column(header, justify="right", no_wrap=True) for header in headers]


def build_table(
    title: str, caption: str, columns: Iterable[Column], rows: Iterable[Sequence[str]]
) -> Table:
    """Return a table for a terminal of 80 characters.

    Args:
        title: Stands above the table.
        caption: Stands below it and says how to read it.
        columns: Made by `text` and `numbers`, or by rich.
        rows: For each row a cell for each column.
    """
    table = Table(
        *columns,
        title=title,
        caption=caption,
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=0,
        title_justify="left",
        caption_justify="left",
    )
    for row in rows:
        table.add_row(*row)
    return table


def build_facts(title: str, caption: str, facts: Mapping[str, str]) -> Table:
    """Return a table of names and what there is to say of each, wrapped to the terminal."""
    return build_table(title, caption, [*text(""), Column()], facts.items())


def new_table(title: str, caption: str) -> Table:
    """Return a table without columns, for callers that add columns and rows themselves."""
    return build_table(title, caption, (), ())


def write_record(path: Path, record: dict[str, Any]) -> None:
    """Write one JSON object to a file of its own.

    Raises:
        NerfregError: The file cannot be written.
    """
    write_json(path, record)
