"""What one scout ray per block of pixels has found, and the intervals that follow from it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from nerfreg.rendering.sampling import equal_shares

FLOOR = 0.1
"""Weight that is spread evenly over a ray, as a share of what its scout has found.

About a tenth of the intervals is thus spread over the whole ray, in case the scouts have missed
something.
"""


@dataclass(frozen=True)
class Scouts:
    """What the scouts of B blocks have found, in N intervals each.

    Attributes:
        edges: (B, N+1) ascending borders of the intervals.
        weights: (B, N) weight of each interval.
        light: (B, N) share of the light that reaches each interval.
    """

    edges: Float[Tensor, "blocks edges"]
    weights: Float[Tensor, "blocks samples"]
    light: Float[Tensor, "blocks samples"]

    def shared(self, blocks: torch.Size) -> Scouts:
        """Return scouts that also know what those around them have found.

        Weights and light become the largest in the adjacent blocks and one interval before and
        behind along the ray.

        Args:
            blocks: Rows and columns of blocks in the image.
        """

        # In a block that holds the silhouette of an object, some pixels look past it at what the
        # block's own scout cannot see. Light has to be shared as well as weights: otherwise what is
        # behind the object counts as dark and is not evaluated (53 holes in a view of the chair
        # edge-on, 13 with it). Intervals are matched by index, which assumes that adjacent rays
        # enter the box at nearly the same distance.
        def around(values: Float[Tensor, "blocks samples"]) -> Float[Tensor, "blocks samples"]:
            return functional.max_pool3d(
                values.view(1, 1, *blocks, -1), 3, stride=1, padding=1
            ).view(values.shape)

        return Scouts(self.edges, around(self.weights), around(self.light))

    def cuts(
        self, blocks: Int[Tensor, " picked"], count: int
    ) -> tuple[Float[Tensor, "picked edges"], Float[Tensor, "picked count"]]:
        """Divide the rays of some blocks into intervals that have equal shares of the weights.

        Args:
            blocks: (P,) index of each block.
            count: Number of intervals.

        Returns:
            (P, count + 1) borders of the intervals, and (P, count) the most light that may reach
            each of them.
        """
        weights = self.weights[blocks]
        weights = weights + FLOOR / weights.shape[1] * weights.sum(dim=1, keepdim=True)
        edges, bins = equal_shares(self.edges[blocks], weights, count)
        # Light falls along the ray, so that its value where an interval begins bounds it.
        return edges, self.light[blocks].gather(1, bins)
