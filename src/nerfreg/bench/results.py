"""The points of a bench as a CSV file, and the looks of its table."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table

from nerfreg.evaluation.files import atomic


def write_csv(path: Path, points: Sequence[Any]) -> Path:
    """One line for each point, a dataclass; its fields are the columns. Raises NerfregError where it cannot."""
    with atomic(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([field.name for field in fields(points[0])])
        writer.writerows(map(_row, points))
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
