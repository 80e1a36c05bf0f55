"""A table of methods, as every format shows it: what is in it, and not how it looks on paper or on a screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from nerfreg.reports.grouping import Setting

Direction = Literal["up", "down"]

NOT_AVAILABLE = "n/a"
NOT_REACHED = "not reached"
ARROWS = {"up": " ↑", "down": " ↓"}


@dataclass(frozen=True)
class Column:
    """name: its heading. unit: of its values, "" for none. format: of its values, as in `format(value, ".2f")`.

    better: which direction is better; None where neither is, and then no cell is marked.
    key: what it is called in a file for programs, e.g. "train_seconds".
    """

    name: str
    unit: str = ""
    format: str = ".3f"
    better: Direction | None = None
    key: str = ""

    @property
    def heading(self) -> str:
        """Name, unit and the direction that is better: `PSNR (dB) ↑`."""
        unit = f" ({self.unit})" if self.unit else ""
        return f"{self.name}{unit}{ARROWS[self.better] if self.better else ''}"


@dataclass(frozen=True)
class Cell:
    """A mean over `count` seeds (or scenes), and their sample standard deviation.

    value: None where nothing is known. spread: None where it has none, as with one seed. text: stands in place of
    the number, e.g. "not reached". at_most: the value is an upper bound. best, second: among the rows that are
    compared in the column, ties included; the paper's rows are never marked.
    """

    value: float | None
    spread: float | None = None
    count: int = 0
    text: str | None = None
    at_most: bool = False
    best: bool = False
    second: bool = False

    def shown(self, column: Column) -> str:
        """What a reader sees of the cell, without marks: `22.21 ± 0.10`, `≤ 12`, `n/a`, `not reached`."""
        if self.text is not None:
            return self.text
        if self.value is None:
            return NOT_AVAILABLE
        mean = ("≤ " if self.at_most else "") + format(self.value, column.format)
        return mean if self.spread is None else f"{mean} ± {format(self.spread, column.format)}"


@dataclass(frozen=True)
class Row:
    """label: the method. cells: one for each column. count: seeds (or scenes) that the row was made of.

    paper: whether its numbers are those of a publication and not of runs.
    """

    label: str
    cells: tuple[Cell, ...]
    count: int = 0
    paper: bool = False


@dataclass(frozen=True)
class Table:
    """title: what all rows share, e.g. "fern, 3 views". counted: what `Row.count` counts, "seeds" or "scenes".

    name: of its files, made of letters that every file system takes, e.g. "fern-3". notes: lines that stand under it.
    setting: the scene that it is about; None for a table over scenes. target: the PSNR that a column times.
    """

    title: str
    name: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    counted: str = "seeds"
    notes: tuple[str, ...] = ()
    setting: Setting | None = None
    target: float | None = None


def marked(columns: Sequence[Column], rows: Sequence[Row]) -> tuple[Row, ...]:
    """The rows with `best` and `second` set. Values that print alike are equal; where all are, none is marked."""
    cells = [list(row.cells) for row in rows]
    for index, column in enumerate(columns):
        printed = {
            row: float(format(value, column.format))
            for row, of_row in enumerate(cells)
            if not rows[row].paper and (value := of_row[index].value) is not None
        }
        order = sorted(set(printed.values()), reverse=column.better == "up")
        if column.better is None or len(order) < 2:
            continue
        for row, value in printed.items():
            cells[row][index] = replace(
                cells[row][index], best=value == order[0], second=value == order[1]
            )
    return tuple(replace(row, cells=tuple(of_row)) for row, of_row in zip(rows, cells, strict=True))
