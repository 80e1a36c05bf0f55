"""The hash grid as a module."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerfreg.field.grid_layout import FEATURES, GridLayout

if TYPE_CHECKING:
    from nerfreg.field.grid_numba import SharedTable


class HashGrid(nn.Module):
    """Multiresolution hash encoding (Mueller et al. 2022) of positions in the unit cube.

    backend: "numba" (CPU only), "torch" or "auto". Table entries start uniform within 1e-4 of zero.
    """

    def __init__(self, layout: GridLayout, backend: str = "auto") -> None:
        super().__init__()
        self.layout = layout
        self.backend = backend
        self.table = nn.Parameter(torch.empty(layout.entries, FEATURES).uniform_(-1e-4, 1e-4))
        self._shared: SharedTable | None = None

    @contextmanager
    def one_gradient(self) -> Iterator[None]:
        """Inside the block all encodings share the buffer of their gradient by the table, where that is possible."""
        if self._compiled(self.table) and torch.is_grad_enabled():
            from nerfreg.field.grid_numba import SharedTable

            self._shared = SharedTable(self.table)
        try:
            yield
        finally:
            self._shared = None

    def forward(
        self, positions: Float[Tensor, "points 3"], levels: int
    ) -> Float[Tensor, "points features"]:
        """Features of the coarsest `levels` levels, (P, 2 * levels); the finer ones are not evaluated."""
        if self._compiled(positions):
            from nerfreg.field import grid_numba

            return grid_numba.encode(positions, self._shared or self.table, self.layout, levels)
        from nerfreg.field import grid_torch

        return grid_torch.encode(positions, self.table, self.layout, levels)

    def _compiled(self, values: Tensor) -> bool:
        fits = values.device.type == "cpu" and values.dtype == torch.float32
        return self.backend == "numba" or (self.backend == "auto" and fits)
