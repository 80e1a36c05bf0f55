"""Tables on the terminal, made in one way by all tools."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any, TypeVar

from rich import box
from rich.console import Console
from rich.table import Column, Table

from nerfreg.files import write_csv, write_json

T = TypeVar("T")


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


def build_record(title: str, record: Mapping[str, Any]) -> Table:
    """Return a table of the words and numbers of a record, with those of its lists in one line."""
    rows = [(name.replace("_", " "), _cell(value)) for name, value in record.items()]
    return build_table(title, "", [*text(""), Column()], rows)


def _cell(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(_cell, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def select(points: Iterable[T], **values: object) -> list[T]:
    """Return the points whose attributes of these names have these values."""
    return [p for p in points if all(getattr(p, name) == values[name] for name in values)]


def write_points(path: Path, points: Sequence[Any]) -> Path:
    """Write dataclasses of one kind as CSV, one a line, with their fields as columns.

    Raises:
        NerfregError: The file cannot be written.
    """
    write_csv(path, [field.name for field in fields(points[0])], map(_line, points))
    return path


def publish_points(
    stem: Path, points: Sequence[T], table: Table, draw: Callable[[Sequence[T], Path], list[Path]]
) -> list[Path]:
    """Print a table, write STEM.csv and a figure, and return the files.

    Args:
        stem: Path of the files without their ending.
        points: Dataclasses of one kind; their fields are the columns of the CSV file.
        table: What is printed.
        draw: Draws the points to STEM.png and STEM.svg, and returns both.

    Raises:
        NerfregError: A file cannot be written.
    """
    Console().print(table)
    return [write_points(stem.with_suffix(".csv"), points), *draw(points, stem)]


def publish_record(path: Path, title: str, record: dict[str, Any]) -> None:
    """Print a record as a table, without what is nested in it, and write it as JSON.

    Raises:
        NerfregError: The file cannot be written.
    """
    flat = {name: value for name, value in record.items() if not isinstance(value, dict)}
    Console().print(build_record(title, flat))
    write_json(path, record)


def _line(point: Any) -> list[object]:
    return [f"{value:.6g}" if isinstance(value, float) else value for value in astuple(point)]
