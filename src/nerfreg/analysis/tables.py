"""What a bench leaves: the points of a CSV file, a JSON record, and the looks of its table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table

from nerfreg.files import write_csv, write_json


@dataclass(frozen=True)
class Outcome:
    """files: what was written. record: the last line of what is printed, as JSON; None: there is none."""

    files: list[Path]
    record: dict[str, Any] | None = None


def write_record(path: Path, record: dict[str, Any]) -> Outcome:
    """One JSON object in a file of its own. Raises NerfregError where it cannot be written."""
    write_json(path, record)
    return Outcome([path], record)


def write_points(path: Path, points: Sequence[Any]) -> Path:
    """One line for each point, a dataclass; its fields are the columns. Raises NerfregError where it cannot."""
    write_csv(path, [field.name for field in fields(points[0])], map(_row, points))
    return path


def _row(point: Any) -> list[object]:
    return [f"{value:.6g}" if isinstance(value, float) else value for value in astuple(point)]


def new_table(title: str, caption: str) -> Table:
    """A table without columns, narrow enough for 80 characters."""
    return Table(
        title=title,
        caption=caption,
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=0,
        title_justify="left",
        caption_justify="left",
    )
