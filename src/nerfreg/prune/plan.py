"""What is to be trained: sets of regularizers, cells of held-out views and seeds, numbers of steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from nerfreg.errors import NerfregError

Selection = tuple[str, ...]
"""Regularizers by name, in the order of the full set."""

USUAL_FOLDS = 4
FEWEST_CELLS = 4
"""An interval from fewer is too wide to be worth looking at."""


@dataclass(frozen=True)
class Cell:
    """Which training views are held out, by their positions, and the seed. All sets are compared cell by cell."""

    held_out: tuple[int, ...]
    seed: int


@dataclass(frozen=True)
class Trial:
    """One training: a set of regularizers on one cell, for so many steps."""

    regularizers: Selection
    cell: Cell
    steps: int


class Context(StrEnum):
    """Among which others a regularizer is judged: all the rest of the full set, or none."""

    SET = "set"
    ALONE = "alone"


@dataclass(frozen=True)
class Comparison:
    """What a regularizer contributes: the set that has it against the set that differs in nothing else."""

    regularizer: str
    context: Context
    having: Selection
    lacking: Selection


@dataclass(frozen=True)
class Design:
    """What a study chooses from.

    full: the regularizers whose contributions are asked for. folds: positions of training views that are held out
    together. ladder: numbers of steps, ascending; the last is that of a whole run. seed: the first.
    """

    full: Selection
    folds: tuple[tuple[int, ...], ...]
    ladder: tuple[int, ...]
    seed: int = 0

    @property
    def first_look(self) -> int:
        """Cells before anything is judged: whole rounds over the folds."""
        return len(self.folds) * math.ceil(FEWEST_CELLS / len(self.folds))

    def cells(self, count: int) -> tuple[Cell, ...]:
        """The first `count` cells: every fold with the first seed, then every fold with the next."""
        rounds = len(self.folds)
        return tuple(Cell(self.folds[i % rounds], self.seed + i // rounds) for i in range(count))

    def comparisons(self, context: Context) -> tuple[Comparison, ...]:
        """One for each regularizer: leaving it out of the full set, or adding it to vanilla."""
        if context is Context.SET:
            return tuple(
                Comparison(name, context, self.full, without(self.full, name)) for name in self.full
            )
        return tuple(Comparison(name, context, (name,), ()) for name in self.full)

    def ordered(self, names: Sequence[str]) -> Selection:
        """These regularizers in the order of the full set."""
        return tuple(name for name in self.full if name in names)

    def label(self, regularizers: Selection) -> str:
        """What a table calls a set."""
        missing = [name for name in self.full if name not in regularizers]
        if not missing:
            return "full set"
        if not regularizers:
            return "vanilla"
        if len(missing) == 1:
            return f"without {missing[0]}"
        return f"{regularizers[0]} alone" if len(regularizers) == 1 else "+".join(regularizers)


def without(regularizers: Selection, name: str) -> Selection:
    return tuple(other for other in regularizers if other != name)


def make_folds(views: int, count: int | None) -> tuple[tuple[int, ...], ...]:
    """Deal the positions 0 to views - 1 into `count` folds; None: four, or one for each view where there are fewer.

    Raises NerfregError where a fold would be empty, or would leave nothing to train on.
    """
    count = min(views, USUAL_FOLDS) if count is None else count
    if not 2 <= count <= views:
        raise NerfregError(f"--folds {count}: {views} training views make 2 to {views} folds")
    return tuple(tuple(range(fold, views, count)) for fold in range(count))


def make_ladder(first: int | None, last: int | None) -> tuple[int, ...]:
    """Numbers of steps: `first` (None: a quarter of `last`), doubled as long as it is below `last`, and `last`.

    Raises NerfregError where `first` is more than `last`, and where that is no number of steps.
    """
    if last is None or last < 1:
        raise NerfregError(
            f"train.steps={last}: prune compares trainings of equal length; set it to 1 or more"
        )
    if first is None:
        first = math.ceil(last / 4)
    if first > last:
        raise NerfregError(
            f"--steps {first}: more than train.steps={last}, the length of a whole run"
        )
    steps = []
    while first < last:
        steps.append(first)
        first *= 2
    return (*steps, last)
