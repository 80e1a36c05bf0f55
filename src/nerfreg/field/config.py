"""What a field is made of."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nerfreg.errors import require_choice, require_range

PRECISIONS = ("float32", "bfloat16")
BACKENDS = ("auto", "numba", "torch")


@dataclass
class FieldConfig:
    """Hash grid and networks.

    levels, base, finest: number of grid levels and their coarsest and finest resolution across the scene's box.
    log2_entries: log2 of the table entries a hashed level has; coarser levels that need fewer are stored densely.
    fit: leave out levels and entries that the training views of the scene cannot fill (`nerfreg.field.fit`).
    hidden, geometry: width of the hidden layers, and of what the density network hands to the colour network.
    density_layers, color_layers: number of layers of each network.
    density_bias: added to the raw density before the exponential.
    precision: "float32", or "bfloat16" for all layers of the networks but the last, in the fused kernels; weights,
        their gradients and what leaves a network stay float32. Faster on processors with instructions for it.
    backend: "auto" (numba on the CPU, torch elsewhere), "numba" or "torch".
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
        one = (1, math.inf)
        require_range(
            "field", self, levels=one, base=one, finest=(self.base, 65536), log2_entries=(3, 26)
        )
        require_range("field", self, hidden=one, geometry=one, density_layers=one, color_layers=one)
        require_choice("field", self, "precision", PRECISIONS)
        require_choice("field", self, "backend", BACKENDS)
