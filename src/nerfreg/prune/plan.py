"""What a study trains: sets of regularizers, held-out views and seeds, numbers of steps."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from nerfreg.errors import NerfregError

Selection = tuple[str, ...]
"""Names of regularizers, in the order of the full set."""

Pair = tuple[Selection, Selection]
"""Two sets that are compared: the first minus the second."""

StudyCell = tuple[tuple[int, ...], int]
"""Positions of the training views that are held out, and a seed. Sets are compared on cells."""

USUAL_FOLDS = 4
FEWEST_CELLS = 4
"""An interval from fewer differences is too wide to be worth computing."""


@dataclass(frozen=True)
class Trial:
    """One training: of which regularizers, on which cell (views held out, seed), how long."""

    regularizers: Selection
    held_out: tuple[int, ...]
    seed: int
    steps: int


@dataclass(frozen=True)
class Stage:
    """How long the trainings are that are compared next, and on how many cells."""

    steps: int
    cells: int


class Context(StrEnum):
    """Beside which others a regularizer is judged: the rest of the full set, or none."""

    SET = "set"
    ALONE = "alone"


@dataclass(frozen=True)
class Design:
    """What a study chooses its trials from.

    Attributes:
        full: The regularizers whose contributions are asked for.
        folds: Positions of training views that are held out together.
        ladder: Numbers of steps, ascending; the last is that of a whole run.
        seed: The first seed.
    """

    full: Selection
    folds: tuple[tuple[int, ...], ...]
    ladder: tuple[int, ...]
    seed: int = 0

    @property
    def views(self) -> int:
        """The number of training views."""
        return sum(map(len, self.folds))

    @property
    def first_look(self) -> int:
        """How many cells are measured before anything is judged: whole rounds over the folds."""
        return len(self.folds) * math.ceil(FEWEST_CELLS / len(self.folds))

    def cells(self, count: int) -> list[StudyCell]:
        """Return the first `count` cells: every fold with the first seed, then with the next."""
        rounds = [divmod(index, len(self.folds)) for index in range(count)]
        return [(self.folds[fold], self.seed + turn) for turn, fold in rounds]

    def pair(self, regularizer: str, context: Context) -> Pair:
        """Return two sets that differ in a regularizer alone, which the first of them has."""
        if context is Context.ALONE:
            return (regularizer,), ()
        return self.full, tuple(name for name in self.full if name != regularizer)

    def trials(self, pairs: Iterable[Pair], stage: Stage) -> list[Trial]:
        """Return the trials that compare pairs at a stage: one cell for all sets, then the next.

        The full set and vanilla stand first. Each cell begins with another set than the last, so
        that whatever else the machine does affects all alike.
        """
        distinct = dict.fromkeys(names for pair in pairs for names in pair)
        sets = sorted(distinct, key=lambda names: (names != self.full, names != ()))
        return [
            Trial(sets[(position + turn) % len(sets)], *cell, stage.steps)
            for position, cell in enumerate(self.cells(stage.cells))
            for turn in range(len(sets))
        ]

    def label(self, regularizers: Selection) -> str:
        """Return the name of a set in tables."""
        missing = [name for name in self.full if name not in regularizers]
        if not missing:
            return "full set"
        if not regularizers:
            return "vanilla"
        if len(missing) == 1:
            return f"without {missing[0]}"
        return f"{regularizers[0]} alone" if len(regularizers) == 1 else "+".join(regularizers)


def make_folds(views: int, count: int | None) -> tuple[tuple[int, ...], ...]:
    """Deal the positions of training views into folds; None: four, or one a view if fewer.

    Raises:
        NerfregError: A fold would be empty, or would leave nothing to train on.
    """
    count = min(views, USUAL_FOLDS) if count is None else count
    if not 2 <= count <= views:
        raise NerfregError(f"--folds {count}: {views} training views make 2 to {views} folds")
    return tuple(tuple(range(fold, views, count)) for fold in range(count))


def make_ladder(first: int | None, last: int | None) -> tuple[int, ...]:
    """Double the steps of the first trainings (None: a quarter of the last) up to the last.

    Raises:
        NerfregError: The last is no number of steps, or the first is more.
    """
    if last is None or last < 1:
        raise NerfregError(
            f"train.steps={last}: prune compares trainings of equal length; set it to 1 or more"
        )
    first = math.ceil(last / 4) if first is None else first
    if first > last:
        raise NerfregError(
            f"--steps {first}: more than train.steps={last}, the length of a whole run"
        )
    doubled = [first << power for power in range(last.bit_length())]
    return (*(steps for steps in doubled if steps < last), last)
