"""Depths of photographs that others agree with: pieces of surface are searched in each view, coarse to fine, and made
consistent among views (Xu, Tao 2019)."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from nerfreg import Photographs
from nerfreg.field.workers import in_shares
from nerfreg.scenes import lens
from nerfreg.scenes.cameras import Cameras
from nerfreg_plugins.stereo.patch_match import NO_MATCH, Comparison, patch_match

BELIEVED = 0.6
"""Cost that a match must be below to be believed: 1 - correlation, and what the sources say against it."""

STEP = 2
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
    """Between which distances along the ray of each pixel there is something, (V, H, W, 2).

    That is `tolerance` pixels either way of where the sources show what the view shows. NaN where no source agrees to
    within that, and where alpha is below 1/2.

    width: to which the longer side of the photographs is reduced, about. window: side of what is compared, in reduced
    pixels. sources: how many nearest views each is compared with.
    """
    straight = _without_lens(photographs)
    factor = max(1, round(max(photographs.images.shape[1:3]) / width))
    half, whole = (_Views(straight, size, sources) for size in (2 * factor, factor))
    limits = 1 / max(photographs.near, NEAREST * photographs.far), 1 / photographs.far
    gap = tolerance * (limits[0] - limits[1]) / whole.shift(*limits)
    search = _Search(half, limits, gap, reach=(window - 1) // (2 * STEP))
    search.improve(guesses=6, sweeps=4, changes=3)
    search = search.enlarged(whole)
    search.improve(sweeps=3, changes=2)
    for _ in range(2):
        search.ask_sources()
        search.improve(sweeps=2, changes=2)
    inverse = torch.where(search.cost < BELIEVED, search.planes[..., 0], torch.nan)
    inverse = torch.stack([whole.agreed(view, inverse, gap) for view in range(len(whole))])
    inverse = torch.stack([inverse + gap, (inverse - gap).clamp_min(limits[1])], dim=-1)
    return torch.stack(
        [
            _along_rays(inverse[view], photographs.cameras, view, factor)
            for view in range(len(whole))
        ]
    )


class _Views:
    """V photographs through straight lenses at 1 / factor of their size, and the views that each is compared with.

    images: (V, H, W, C). opaque: (V, H, W). sources: of each view.
    """

    def __init__(self, photographs: Photographs, factor: int, sources: int) -> None:
        images = photographs.images
        if images.shape[-1] == 4:
            images = torch.cat([images[..., :3] * images[..., 3:], images[..., 3:]], dim=-1)
        pooled = functional.avg_pool2d(images.permute(0, 3, 1, 2), factor, ceil_mode=True)
        self.images = pooled.permute(0, 2, 3, 1).contiguous()
        self.opaque = torch.ones(self.images.shape[:3], dtype=torch.bool)
        if images.shape[-1] == 4:
            self.opaque = self.images[..., 3] > 0.5
        self.cameras, self.factor = photographs.cameras, factor
        positions = self.cameras.positions
        self.sources = (
            torch.cdist(positions, positions).argsort(stable=True)[:, 1 : sources + 1].tolist()
        )

    def __len__(self) -> int:
        return len(self.images)

    def seen_from(
        self, view: int, source: int
    ) -> tuple[Float[Tensor, "height width 3"], Float[Tensor, " 3"]]:
        """(ahead, shift): the point of a pixel at inverse depth w is at (x / z, y / z) of (x, y, z) = ahead + w shift.

        In reduced pixels of the source. z / w is the depth there. Depths are along the optical axes.
        """
        height, width = self.opaque.shape[1:]
        pixels = self.factor * (_pixels(height, width).view(-1, 2) + 0.5)
        directions = self.cameras.rays_through(torch.full((len(pixels),), view), pixels)[1]
        directions = directions / (directions @ self.cameras.axes[view])[:, None]
        apart = self.cameras.positions[view] - self.cameras.positions[source]
        right, up, back = self.cameras.poses[source, :, :3].unbind(1)
        focal, center = (
            self.cameras.focal[source] / self.factor,
            self.cameras.center[source] / self.factor,
        )
        projection = torch.stack(
            [focal[0] * right - center[0] * back, -focal[1] * up - center[1] * back, -back]
        )
        return (directions @ projection.T).view(height, width, 3), projection @ apart

    def shift(self, nearest: float, farthest: float) -> float:
        """By how many pixels what a source shows of a ray moves from the nearest depth to the farthest.

        The median over pixels, the largest over views and sources; at least 1.
        """
        shifts = [1.0]
        for view, sources in enumerate(self.sources):
            for source in sources:
                ahead, shift = self.seen_from(view, source)
                near, far = (_place(ahead + inverse * shift) for inverse in (nearest, farthest))
                shifts.append(float((near - far).norm(dim=-1).nanmedian().nan_to_num(0.0)))
        return max(shifts)

    def agreed(
        self, view: int, inverse_depth: Float[Tensor, "views height width"], gap: float
    ) -> Float[Tensor, "height width"]:
        """Inverse depths of a view where, to within `gap`, some source has a point as well; elsewhere NaN."""
        own = inverse_depth[view]
        agreed = torch.zeros_like(own, dtype=torch.bool)
        for source in self.sources[view]:
            ahead, shift = self.seen_from(view, source)
            there = ahead + own[..., None] * shift
            theirs = _looked_up(inverse_depth[source], _place(there))
            agreed |= (own / there[..., 2] - theirs).abs() < gap
        return torch.where(agreed & self.opaque[view], own, torch.nan)


class _Search:
    """What is known so far. planes, cost: of each view as in `patch_match`."""

    def __init__(self, views: _Views, limits: tuple[float, float], gap: float, reach: int) -> None:
        self.views, self.limits, self.gap, self.reach = views, limits, gap, reach
        self.planes = torch.zeros(*views.opaque.shape, 3)
        self.cost = torch.full(views.opaque.shape, NO_MATCH)
        self.believed = torch.full(views.opaque.shape, torch.nan)

    def improve(self, guesses: int = 0, sweeps: int = 0, changes: int = 0) -> None:
        """See `patch_match`."""

        def improve_some(first: int, last: int) -> None:
            for view in range(first, last):
                if self.views.sources[view]:
                    comparison, there = self._comparison(view), self.views.opaque[view].numpy()
                    limits, effort = map(np.float32, self.limits), (guesses, sweeps, changes)
                    found = self.planes[view].numpy(), self.cost[view].numpy()
                    patch_match(comparison, there, *limits, *effort, view, *found)

        in_shares(len(self.views), 1, improve_some)

    def ask_sources(self) -> None:
        """From now on it costs to be elsewhere than where the sources, by now, believe a surface to be."""
        self.believed = torch.where(self.planes[..., 0] > 0, self.planes[..., 0], torch.nan)

    def enlarged(self, views: _Views) -> _Search:
        """The same at another size."""
        larger = _Search(views, self.limits, self.gap, self.reach)
        rows, columns = (
            torch.arange(there) * here // there
            for here, there in zip(self.cost.shape[1:], larger.cost.shape[1:], strict=True)
        )
        larger.planes = self.planes[:, rows][:, :, columns].contiguous()
        return larger

    def _comparison(self, view: int) -> Comparison:
        views, sources = self.views, self.views.sources[view]
        ahead, shift = zip(*(views.seen_from(view, source) for source in sources), strict=True)
        return Comparison(
            own=views.images[view].numpy(),
            others=views.images[sources].numpy(),
            ahead=torch.stack(ahead).numpy(),
            shift=torch.stack(shift).numpy(),
            believed=self.believed[sources].numpy(),
            gap=np.float32(self.gap),
            focal=np.float32(views.cameras.focal[view].mean() / views.factor),
            reach=self.reach,
            step=STEP,
        )


def _pixels(height: int, width: int) -> Int[Tensor, "height width 2"]:
    """(x, y) of all."""
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return torch.stack([x, y], dim=-1)


def _place(point: Float[Tensor, "*many 3"]) -> Float[Tensor, "*many 2"]:
    """(x / z, y / z); NaN behind the camera."""
    return point[..., :2] / torch.where(point[..., 2:] > 0, point[..., 2:], torch.nan)


def _looked_up(
    image: Float[Tensor, "height width *more"], places: Float[Tensor, "*many 2"]
) -> Tensor:
    """What the pixels at places (x, y) hold; NaN outside."""
    height, width = image.shape[:2]
    x, y = places.floor().nan_to_num(-1).unbind(-1)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    held = image[torch.where(inside, y, 0).long(), torch.where(inside, x, 0).long()]
    return torch.where(
        inside.view(*inside.shape, *[1] * (held.dim() - inside.dim())), held, torch.nan
    )


def _without_lens(photographs: Photographs) -> Photographs:
    """What the cameras would have seen without distortion."""
    cameras = photographs.cameras
    if not cameras.distortion.any():
        return photographs
    height, width = photographs.images.shape[1:3]
    middles = _pixels(height, width).view(-1, 2) + 0.5
    size = torch.tensor([width, height])
    grid = []
    for focal, center, distortion in zip(
        cameras.focal, cameras.center, cameras.distortion, strict=True
    ):
        bent = (
            lens.distort((middles - center) / focal, distortion.expand(len(middles), 5)) * focal
            + center
        )
        grid.append((2 * bent / size - 1).view(height, width, 2))
    images = functional.grid_sample(
        photographs.images.permute(0, 3, 1, 2),
        torch.stack(grid),
        padding_mode="border",
        align_corners=False,
    )
    straight = dataclasses.replace(cameras, distortion=torch.zeros_like(cameras.distortion))
    return dataclasses.replace(
        photographs, cameras=straight, images=images.permute(0, 2, 3, 1).contiguous()
    )


def _along_rays(
    inverse_depth: Float[Tensor, "height width 2"], cameras: Cameras, view: int, factor: int
) -> Float[Tensor, "full_height full_width 2"]:
    """Distances along the rays of all pixels of a photograph, from inverse depths without its lens and reduced."""
    directions = cameras.image_rays(view)[1]
    local = directions @ cameras.poses[view, :, :3]
    straight = (
        local[:, :2] * torch.tensor([1.0, -1.0]) / -local[:, 2:] * cameras.focal[view]
        + cameras.center[view]
    )
    found = _looked_up(inverse_depth, straight / factor)
    return (1 / (found * -local[:, 2:])).view(cameras.height, cameras.width, 2)
