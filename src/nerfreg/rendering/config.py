"""Where a ray is sampled."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nerfreg.errors import require_choice, require_range


@dataclass
class SamplerConfig:
    """Stratified samples, then importance samples of the same network, all of them rendered.

    coarse, fine: samples per ray of the first and second kind (64 + 128 in the paper).
    spacing: "linear" spreads the coarse samples evenly in distance, "disparity" in its reciprocal.
    skip_resolution: cells a side of the occupancy grid that lets test views skip empty space.
    view_samples: intervals a ray of a test view is cut into, most of them where a scout has found density.
    view_block, scout_samples: one scout, with so many samples, for every block of pixels of this side.
    """

    coarse: int = 64
    fine: int = 128
    spacing: str = "linear"
    skip_resolution: int = 128
    view_samples: int = 64
    view_block: int = 4
    scout_samples: int = 64

    def __post_init__(self) -> None:
        require_range(
            "sampler", self, coarse=(1, math.inf), fine=(0, math.inf), skip_resolution=(1, 512)
        )
        require_range("sampler", self, view_samples=(1, math.inf), view_block=(1, 16))
        require_range("sampler", self, scout_samples=(1, math.inf))
        require_choice("sampler", self, "spacing", ("linear", "disparity"))
