"""Map the vertices of a multiresolution grid to one flat table (Mueller et al. 2022, section 3)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

FEATURES = 2
"""Features per level."""

PRIMES = (1, 2654435761, 805459861)
"""The factors of the spatial hash: the exclusive or of the coordinates times these, modulo the
table size. The first is 1, so that neighbours along x stay close together in memory."""


@dataclass(frozen=True)
class GridLayout:
    """Levels whose resolution grows geometrically.

    A level is dense, with one entry for every vertex, if its vertices fit into `2^log2_entries`
    entries; otherwise it is hashed.

    Attributes:
        levels: Number of levels, L.
        base: Cells per side of the coarsest level.
        finest: Cells per side of the finest level.
        log2_entries: log2 of the number of entries of a hashed level.
    """

    levels: int
    base: int
    finest: int
    log2_entries: int

    @cached_property
    def resolutions(self) -> np.ndarray:
        """Cells per side of each level, `(L,)`."""
        growth = (self.finest / self.base) ** (1 / max(self.levels - 1, 1))
        # The finest level must have exactly `finest` cells, even if the power falls just short.
        return np.array(
            [int(self.base * growth**level + 1e-6) for level in range(self.levels)], dtype=np.int64
        )

    @cached_property
    def dense(self) -> np.ndarray:
        """Which levels have a table entry for every vertex, `(L,)`."""
        dense: np.ndarray = (self.resolutions + 1) ** 3 <= 2**self.log2_entries
        return dense

    @cached_property
    def offsets(self) -> np.ndarray:
        """First table entry of each level, and the number of all entries at the end, `(L + 1,)`."""
        sizes = np.where(self.dense, (self.resolutions + 1) ** 3, 2**self.log2_entries)
        return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)

    @property
    def entries(self) -> int:
        """Number of table entries of all levels."""
        return int(self.offsets[-1])

    @property
    def features(self) -> int:
        """Number of features of an encoded position."""
        return FEATURES * self.levels
