"""The multiresolution hash grid as a torch module."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerfreg.field import grid_numba, grid_torch
from nerfreg.field.grid_layout import FEATURES, GridLayout
from nerfreg.field.grid_level import GridLevel
from nerfreg.field.grid_shared import SharedTable


class HashGrid(nn.Module):
    """Multiresolution hash encoding (Mueller et al. 2022) of positions in the unit cube.

    Table entries are initialized uniformly in [-1e-4, 1e-4], as in the paper.

    Attributes:
        layout: Resolutions of the levels and their places in the table.
        backend: "numba" (CPU only), "torch" or "auto".
        table: The features of all levels, `(entries, 2)`.
    """

    def __init__(self, layout: GridLayout, backend: str = "auto") -> None:
        """Allocate and initialize the table."""
        super().__init__()
        self.layout = layout
        self.backend = backend
        self.table = nn.Parameter(torch.empty(layout.entries, FEATURES).uniform_(-1e-4, 1e-4))
        self._shared: SharedTable | None = None
        self._latest: SharedTable | None = None

    @contextmanager
    def one_gradient(self) -> Iterator[None]:
        """Let all encodings inside the block add their table gradients to one buffer.

        A step evaluates the grid twice, and a second buffer would have to be zeroed and added:
        100 MB of writes at 2^19 entries. What `gradient` and `tables` read later in the step is
        added to the same buffer. With the torch backend the block has no effect on encodings.
        """
        if self._compiled(self.table) and torch.is_grad_enabled():
            self._shared = SharedTable(self.table)
            if self.table.requires_grad:
                self._latest = self._shared
        try:
            yield
        finally:
            self._shared = None

    @contextmanager
    def same_gradient(self) -> Iterator[None]:
        """Let encodings inside the block add to the buffer of the latest `one_gradient`.

        For points that a loss evaluates in a step whose rays have been rendered.
        """
        if self._compiled(self.table) and torch.is_grad_enabled():
            self._shared = self._share()
        try:
            yield
        finally:
            self._shared = None

    def forward(
        self, positions: Float[Tensor, "points 3"], levels: int
    ) -> Float[Tensor, "points features"]:
        """Encode positions with the coarsest levels.

        Args:
            positions: Positions in the unit cube, `(P, 3)`.
            levels: Number of levels to evaluate, from the coarsest; the finer ones cost nothing.

        Returns:
            The features, `(P, 2 * levels)`, differentiable twice.
        """
        if self._compiled(positions):
            return grid_numba.encode(positions, self._shared or self.table, self.layout, levels)
        return grid_torch.encode(positions, self.table, self.layout, levels)

    def gradient(
        self, positions: Float[Tensor, "points 3"], grad: Float[Tensor, "points features"]
    ) -> Float[Tensor, "points 3"]:
        """Take a gradient by the features to the positions.

        Args:
            positions: Positions in the unit cube, `(P, 3)`.
            grad: Gradient by the features of the coarsest levels, `(P, 2 * levels)`.

        Returns:
            The sum over the features of `grad` times the derivative of the feature, `(P, 3)`. It
            is differentiable by the positions, `grad` and the table. Positions that require no
            gradient save the cost of theirs.
        """
        if self._compiled(positions):
            return grid_numba.gradient(positions, grad, self._share(), self.layout)
        return grid_torch.gradient(positions, grad, self.table, self.layout)

    @property
    def tables(self) -> tuple[GridLevel, ...]:
        """The levels, coarsest first, for losses on the grid itself.

        With either backend, what all of them read in a step adds its gradient to one buffer.
        """
        return tuple(
            GridLevel(self.layout, level, self._share, lambda: self._compiled(self.table))
            for level in range(self.layout.levels)
        )

    def _share(self) -> SharedTable:
        """The latest shared table, or a new one where the parameter has changed since."""
        if not (torch.is_grad_enabled() and self.table.requires_grad):
            # Made without a graph. What reads the table later and wants a gradient must not get it.
            return SharedTable(self.table)
        if self._latest is None or not self._latest.serves(self.table):
            self._latest = SharedTable(self.table)
        return self._latest

    def _compiled(self, values: Tensor) -> bool:
        fits = values.device.type == "cpu" and values.dtype == torch.float32
        return self.backend == "numba" or (self.backend == "auto" and fits)

    def __getstate__(self) -> dict[str, Any]:
        # Tensors within a graph can be neither copied nor pickled, and the next step makes others.
        return {**self.__dict__, "_shared": None, "_latest": None}
