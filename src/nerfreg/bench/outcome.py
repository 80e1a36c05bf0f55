"""What every bench leaves behind, and how it is printed and written."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.table import Table

from nerfreg.analysis.tables import build_record, write_points
from nerfreg.files import write_json

T = TypeVar("T")


@dataclass(frozen=True)
class BenchOutcome:
    """The files that were written, and a JSON object to print in one line, if there is one."""

    files: list[Path]
    record: dict[str, Any] | None = None


def publish_points(
    stem: Path, points: Sequence[T], table: Table, draw: Callable[[Sequence[T], Path], list[Path]]
) -> BenchOutcome:
    """Print a table, and write STEM.csv and a figure.

    Args:
        stem: Path of the files without their ending.
        points: Dataclasses of one kind; their fields are the columns of the CSV file.
        table: What is printed.
        draw: Draws the points to STEM.png and STEM.svg, and returns both.
    """
    Console().print(table)
    return BenchOutcome([write_points(stem.with_suffix(".csv"), points), *draw(points, stem)])


def publish_record(path: Path, title: str, record: dict[str, Any]) -> BenchOutcome:
    """Print a record as a table, without what is nested in it, and write it as JSON."""
    flat = {name: value for name, value in record.items() if not isinstance(value, dict)}
    Console().print(build_record(title, flat))
    write_json(path, record)
    return BenchOutcome([path], record)


def announced(items: Iterable[T], describe: Callable[[T], str]) -> Iterator[T]:
    """Yield items, and show on stderr which of them is being measured."""
    with Console(stderr=True).status("") as status:
        for item in items:
            status.update(describe(item))
            yield item
            # Trainers are in cycles of references and would stay in memory beside the next ones.
            gc.collect()
