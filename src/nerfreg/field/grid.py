"""The hash grid as a module."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerfreg.field.grid_layout import FEATURES, GridLayout


class HashGrid(nn.Module):
    """Multiresolution hash encoding (Mueller et al. 2022) of positions in the unit cube.

    backend: "numba" (CPU only), "torch" or "auto". Table entries start uniform within 1e-4 of zero.
    """

    def __init__(self, layout: GridLayout, backend: str = "auto") -> None:
        super().__init__()
        self.layout = layout
        self.backend = backend
        self.table = nn.Parameter(torch.empty(layout.entries, FEATURES).uniform_(-1e-4, 1e-4))

    def forward(self, positions: Float[Tensor, "points 3"], levels: int) -> Float[Tensor, "points features"]:
        """Features of the coarsest `levels` levels, (P, 2 * levels); the finer ones are not evaluated."""
        compiled = self.backend == "numba" or (
            self.backend == "auto" and positions.device.type == "cpu" and positions.dtype == torch.float32
        )
        if compiled:
            from nerfreg.field.grid_numba import encode
        else:
            from nerfreg.field.grid_torch import encode
        return encode(positions, self.table, self.layout, levels)
