"""A table of methods: what is in it, and not how it looks on paper or on a screen."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from nerfreg.reports.records import Setting

NOT_REACHED = "not reached"
ARROWS = {"up": " ↑", "down": " ↓"}


@dataclass(frozen=True)
class Column:
    """A column of numbers.

    Attributes:
        name: Its heading.
        unit: Of its values; "" for none.
        format: Of its values, as in `format(value, ".2f")`.
        better: Which direction is better; None where neither is, and then no cell is marked.
        key: What it is called in a file for programs, e.g. "train_seconds".
    """

    name: str
    unit: str = ""
    format: str = ".3f"
    better: Literal["up", "down"] | None = None
    key: str = ""

    @property
    def heading(self) -> str:
        """Name, unit and the direction that is better: `PSNR (dB) ↑`."""
        unit = f" ({self.unit})" if self.unit else ""
        return f"{self.name}{unit}{ARROWS[self.better] if self.better else ''}"


@dataclass(frozen=True)
class TableCell:
    """A mean over seeds or scenes, as it stands in a table.

    Attributes:
        value: The mean; None where nothing is known.
        spread: The sample standard deviation; None where there is none, as with one seed.
        count: How many values the mean is of.
        text: Stands in place of the number, e.g. "not reached".
        at_most: Whether the value is an upper bound.
        best: Whether no row that is compared in the column is better; ties are best together.
        second: Whether it is the best of the rest.
    """

    value: float | None = None
    spread: float | None = None
    count: int = 0
    text: str | None = None
    at_most: bool = False
    best: bool = False
    second: bool = False

    def shown(self, column: Column) -> str:
        """Return what a reader sees: `22.21 ± 0.10`, `≤ 12`, `n/a`, `not reached`."""
        if self.value is None:
            return self.text or "n/a"
        mean = ("≤ " if self.at_most else "") + format(self.value, column.format)
        return mean if self.spread is None else f"{mean} ± {format(self.spread, column.format)}"


@dataclass(frozen=True)
class Row:
    """A method with a cell for each column, made of `count` runs, or published in a paper."""

    label: str
    cells: tuple[TableCell, ...]
    count: int = 0
    paper: bool = False

    @property
    def counted(self) -> str:
        """The count as a cell of the table."""
        return "" if self.paper else str(self.count)


@dataclass(frozen=True)
class Table:
    """A table with its heading and notes.

    Attributes:
        title: What all rows share, e.g. "fern, 3 views".
        name: Of its files, made of letters that every file system takes, e.g. "fern-3".
        columns: Of numbers, between the method and the count.
        rows: Those of the paper last.
        counted: What `Row.count` counts: "seeds" or "runs".
        notes: Lines that stand under it.
        setting: What it is about; None for a table over scenes.
        target: The PSNR that a column times.
    """

    title: str
    name: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    counted: str = "seeds"
    notes: tuple[str, ...] = ()
    setting: Setting | None = None
    target: float | None = None

    @property
    def headings(self) -> list[str]:
        """Of all columns, the method and the count included."""
        return ["method", *(column.heading for column in self.columns), self.counted]


def mean_of(values: Iterable[float | None]) -> TableCell:
    """Return mean and sample standard deviation of the values that are known."""
    known = [value for value in values if value is not None]
    if not known:
        return TableCell()
    spread = statistics.stdev(known) if len(known) > 1 else None
    return TableCell(statistics.fmean(known), spread, len(known))


def mean_over_scenes(scenes: Sequence[TableCell]) -> TableCell:
    """Return the mean of the scenes' means, or none where a scene has none.

    The spread is that of a mean over one run of each scene, sqrt(sum of variances) / number of
    scenes, where all have one.
    """
    if len(scenes) == 1:
        return scenes[0]
    means = [cell.value for cell in scenes if cell.value is not None]
    if not means or len(means) < len(scenes):
        some = f"reached on {len(means)} of {len(scenes)} scenes" if means else NOT_REACHED
        return TableCell(text=some if any(cell.text for cell in scenes) else None)
    deviations = [cell.spread for cell in scenes if cell.spread is not None]
    spread = math.hypot(*deviations) / len(means) if len(deviations) == len(means) else None
    count, at_most = sum(cell.count for cell in scenes), any(cell.at_most for cell in scenes)
    return TableCell(statistics.fmean(means), spread, count, at_most=at_most)


def marked(columns: Sequence[Column], rows: Sequence[Row]) -> tuple[Row, ...]:
    """Return the rows with `best` and `second` set.

    Values that print alike are equal; where all are, none is marked.
    """
    cells = [list(row.cells) for row in rows]
    for index, column in enumerate(columns):
        printed = {
            number: float(format(value, column.format))
            for number, row in enumerate(rows)
            if not row.paper and (value := row.cells[index].value) is not None
        }
        order = sorted(set(printed.values()), reverse=column.better == "up")
        if column.better is None or len(order) < 2:
            continue
        for number, value in printed.items():
            places: dict[str, Any] = {"best": value == order[0], "second": value == order[1]}
            cells[number][index] = replace(cells[number][index], **places)
    return tuple(replace(row, cells=tuple(own)) for row, own in zip(rows, cells, strict=True))
