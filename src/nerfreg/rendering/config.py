"""Options of the sampler: where a ray is sampled."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from nerfreg.errors import require_choice, require_range


class SampleCounts(NamedTuple):
    """Numbers of stratified and of importance samples of a training ray."""

    coarse: int
    fine: int


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
        inside: Share of these samples that rays get where plugins have declared space empty: they
            are spread over what is left of each ray, so that fewer lie as densely.
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
    inside: float = 0.5
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
            inside=(1e-3, 1.0),
            skip_resolution=(1, 512),
            view_samples=(1, math.inf),
            view_block=(1, 16),
            scout_samples=(1, math.inf),
        )
        require_choice("sampler", self, "spacing", ("linear", "disparity"))

    @property
    def counts(self) -> SampleCounts:
        """Samples of a ray on which anything may be anywhere."""
        return SampleCounts(self.coarse, self.fine)

    @property
    def counts_inside(self) -> SampleCounts:
        """Samples of a ray of which plugins know where it is empty."""
        return SampleCounts(
            max(round(self.coarse * self.inside), 1), round(self.fine * self.inside)
        )
