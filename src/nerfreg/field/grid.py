"""The multiresolution hash grid as a torch module."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerfreg.field import grid_numba, grid_torch
from nerfreg.field.grid_layout import FEATURES, GridLayout


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
        self._shared: grid_numba.SharedTable | None = None

    @contextmanager
    def one_gradient(self) -> Iterator[None]:
        """Let all encodings inside the block add their table gradients to one buffer.

        A step evaluates the grid twice, and a second buffer would have to be zeroed and added:
        100 MB of writes at 2^19 entries. With the torch backend the block has no effect.
        """
        if self._compiled(self.table) and torch.is_grad_enabled():
            self._shared = grid_numba.SharedTable(self.table)
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
            The features, `(P, 2 * levels)`.
        """
        if self._compiled(positions):
            return grid_numba.encode(positions, self._shared or self.table, self.layout, levels)
        return grid_torch.encode(positions, self.table, self.layout, levels)

    def _compiled(self, values: Tensor) -> bool:
        fits = values.device.type == "cpu" and values.dtype == torch.float32
        return self.backend == "numba" or (self.backend == "auto" and fits)
