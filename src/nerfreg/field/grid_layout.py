"""Where the vertices of a multiresolution grid live in one flat table (Mueller et al. 2022, section 3)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

FEATURES = 2
"""Features per level."""

PRIMES = (1, 2654435761, 805459861)
"""The spatial hash: the exclusive or of the coordinates times these, modulo the table size."""


@dataclass(frozen=True)
class GridLayout:
    """Geometric levels from `base` to `finest` cells a side; a level is dense if its vertices fit its table."""

    levels: int
    base: int
    finest: int
    log2_entries: int

    @cached_property
    def resolutions(self) -> np.ndarray:
        """(L,) cells a side of each level."""
        growth = (self.finest / self.base) ** (1 / max(self.levels - 1, 1))
        return np.array(
            [int(self.base * growth**level + 1e-6) for level in range(self.levels)], dtype=np.int64
        )

    @cached_property
    def dense(self) -> np.ndarray:
        """(L,) which levels have a table entry for every vertex."""
        return (self.resolutions + 1) ** 3 <= 2**self.log2_entries

    @cached_property
    def offsets(self) -> np.ndarray:
        """(L+1,) first table entry of each level, and the number of entries at the end."""
        sizes = np.where(self.dense, (self.resolutions + 1) ** 3, 2**self.log2_entries)
        return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)

    @property
    def entries(self) -> int:
        return int(self.offsets[-1])

    @property
    def features(self) -> int:
        return FEATURES * self.levels
