"""Options of the sampler: where a ray is sampled."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nerfreg.errors import require_choice, require_range


@dataclass
class SamplerConfig:
    """Where rays are sampled, in training and in test views.

    A training ray gets stratified (coarse) samples, then importance (fine) samples; both are
    evaluated with the same network, and all of them are composited.

    Attributes:
        coarse: Stratified samples per ray; 64 in the CombiNeRF paper.
        fine: Importance samples per ray; 128 in the CombiNeRF paper.
        spacing: "linear" spaces the coarse samples evenly in distance, "disparity" in its
            reciprocal.
        skip_resolution: Cells per side of the occupancy grid with which test views skip empty
            space.
        view_samples: Intervals into which a ray of a test view is divided, most of them where a
            scout ray has found density.
        view_block: Side, in pixels, of the blocks that share one scout ray in a test view.
        scout_samples: Samples of a scout ray.
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
            "sampler",
            self,
            coarse=(1, math.inf),
            # Without importance samples the coarse ones are composited alone.
            fine=(0, math.inf),
            skip_resolution=(1, 512),
            view_samples=(1, math.inf),
            view_block=(1, 16),
            scout_samples=(1, math.inf),
        )
        require_choice("sampler", self, "spacing", ("linear", "disparity"))
