"""The search for depth that photographs agree on.

Pieces of surface are searched in each view, coarse to fine, and then made consistent among views.

Source: Xu, Tao 2019.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg import Photographs
from nerfreg.field.workers import in_shares
from nerfreg_plugins.stereo.patch_match import NO_MATCH, MatchingProblem, patch_match
from nerfreg_plugins.stereo.views import PinholeViews, along_rays, without_distortion

MAX_COST = 0.6
"""Cost that a match must be below: 1 - correlation, and disagreement with the sources."""

STRIDE = 2
"""A window has every second pixel."""

NEAREST = 1e-3
"""The nearest depth, as a share of the farthest one's, where rays begin at 0."""


def agreed_depth(
    photographs: Photographs,
    width: int = 512,
    window: int = 9,
    sources: int = 4,
    tolerance: float = 1.0,
) -> Float[Tensor, "views height width 2"]:
    """Return between which distances along the ray of each pixel there is something.

    That is `tolerance` pixels either way of where the sources show what the view shows.

    Args:
        photographs: The training views.
        width: To which the longer side of the photographs is reduced, about.
        window: Side of what is compared, in reduced pixels.
        sources: With how many of the nearest views each is compared.
        tolerance: Reduced pixels to which they have to agree.

    Returns:
        `(V, H, W, 2)`; NaN where no source agrees, and where alpha is below 1/2.
    """
    straight = without_distortion(photographs)
    factor = max(1, round(max(photographs.images.shape[1:3]) / width))
    half, whole = (PinholeViews(straight, size, sources) for size in (2 * factor, factor))
    limits = 1 / max(photographs.near, NEAREST * photographs.far), 1 / photographs.far
    # A pixel in a source is about the same difference of inverse depth all along a ray, so that one
    # number says what agreement to within `tolerance` pixels is.
    gap = tolerance * (limits[0] - limits[1]) / whole.disparity(*limits)
    # Random guesses at half the size alone, where each is cheaper and a match is found from further
    # away; the full size starts from what they led to.
    search = _Search(half, limits, gap, reach=(window - 1) // (2 * STRIDE))
    search.improve(guesses=6, sweeps=4, changes=3)
    search = search.enlarged(whole)
    search.improve(sweeps=3, changes=2)
    for _ in range(2):
        search.ask_sources()
        search.improve(sweeps=2, changes=2)
    inverse = torch.where(search.cost < MAX_COST, search.planes[..., 0], torch.nan)
    inverse = torch.stack([whole.consistent(view, inverse, gap) for view in range(len(whole))])
    # Nearest first. The far end stays within the scene, which also keeps it positive.
    inverse = torch.stack([inverse + gap, (inverse - gap).clamp_min(limits[1])], dim=-1)
    return torch.stack(
        [along_rays(inverse[view], photographs.cameras, view, factor) for view in range(len(whole))]
    )


class _Search:
    """What is known so far.

    Attributes:
        views: The photographs.
        limits: Largest and smallest inverse depth.
        gap: How far two inverse depths of one surface may differ.
        reach: Pixels that a window has either way of its middle.
        planes: Of each view as in `patch_match`, `(V, H, W, 3)`.
        cost: Of each plane, `(V, H, W)`.
        known: Inverse depths that a view contradicts at a cost, `(V, H, W)`; NaN for none.
    """

    def __init__(
        self, views: PinholeViews, limits: tuple[float, float], gap: float, reach: int
    ) -> None:
        self.views, self.limits, self.gap, self.reach = views, limits, gap, reach
        self.planes = torch.zeros(*views.opaque.shape, 3)
        self.cost = torch.full(views.opaque.shape, NO_MATCH)
        self.known = torch.full(views.opaque.shape, torch.nan)

    def improve(self, guesses: int = 0, sweeps: int = 0, changes: int = 0) -> None:
        """Run `patch_match` on all views."""

        def improve_some(first: int, last: int) -> None:
            for view in range(first, last):
                if self.views.sources[view]:
                    problem, mask = self._problem(view), self.views.opaque[view].numpy()
                    limits, effort = map(np.float32, self.limits), (guesses, sweeps, changes)
                    found = self.planes[view].numpy(), self.cost[view].numpy()
                    patch_match(problem, mask, *limits, *effort, view, *found)

        in_shares(len(self.views), 1, improve_some)

    def ask_sources(self) -> None:
        """Make it cost from now on to contradict what the sources have found by now.

        A copy of what they have found, so that a view that is searched next to its sources does not
        see them change, and the order of views makes no difference.
        """
        self.known = torch.where(self.planes[..., 0] > 0, self.planes[..., 0], torch.nan)

    def enlarged(self, views: PinholeViews) -> _Search:
        """Return the same planes at another size; their costs are to be found again."""
        larger = _Search(views, self.limits, self.gap, self.reach)
        rows, columns = (
            torch.arange(there) * here // there
            for here, there in zip(self.cost.shape[1:], larger.cost.shape[1:], strict=True)
        )
        larger.planes = self.planes[:, rows][:, :, columns].contiguous()
        return larger

    def _problem(self, view: int) -> MatchingProblem:
        views, sources = self.views, self.views.sources[view]
        projections = [views.projection(view, source) for source in sources]
        at_infinity, epipole = (torch.stack(part) for part in zip(*projections, strict=True))
        return MatchingProblem(
            image=views.images[view].numpy(),
            sources=views.images[sources].numpy(),
            at_infinity=at_infinity.numpy(),
            epipole=epipole.numpy(),
            source_depths=self.known[sources].numpy(),
            gap=np.float32(self.gap),
            focal=np.float32(views.cameras.focal[view].mean() / views.factor),
            reach=self.reach,
            stride=STRIDE,
        )
