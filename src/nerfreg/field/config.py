"""The configuration of a field."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nerfreg.errors import require_choice, require_range

PRECISIONS = ("float32", "bfloat16")
BACKENDS = ("auto", "numba", "torch")


@dataclass
class FieldConfig:
    """Hash grid and networks, after instant-ngp (Mueller et al. 2022).

    Attributes:
        levels: Number of grid levels.
        base: Resolution of the coarsest level, in cells across the scene's box.
        finest: Resolution of the finest level, in cells across the scene's box.
        log2_entries: log2 of the number of table entries of a hashed level. Coarser levels that
            need fewer are stored densely.
        fit: Whether to leave out levels and entries that the training views of the scene cannot
            fill (see `nerfreg.field.fit`).
        hidden: Width of the hidden layers of both networks.
        geometry: Number of features that the density network passes on to the colour network.
        density_layers: Number of layers of the density network.
        color_layers: Number of layers of the colour network.
        density_bias: Added to the raw density before the exponential.
        precision: "float32", or "bfloat16" for all layers but the last of each network where the
            fused kernels run. Weights, their gradients and the output of a network stay float32.
            Faster on processors with bfloat16 instructions.
        backend: Implementation of the hash grid: "auto" (numba on the CPU, torch elsewhere),
            "numba" or "torch".
    """

    levels: int = 16
    base: int = 16
    finest: int = 1024
    log2_entries: int = 17
    fit: bool = False
    hidden: int = 64
    geometry: int = 15
    density_layers: int = 2
    color_layers: int = 3
    density_bias: float = 0.0
    precision: str = "float32"
    backend: str = "auto"

    def __post_init__(self) -> None:
        """Raise NerfregError for values out of range."""
        one = (1, math.inf)
        require_range(
            "field", self, levels=one, base=one, finest=(self.base, 65536), log2_entries=(3, 26)
        )
        require_range("field", self, hidden=one, geometry=one, density_layers=one, color_layers=one)
        require_choice("field", self, "precision", PRECISIONS)
        require_choice("field", self, "backend", BACKENDS)
