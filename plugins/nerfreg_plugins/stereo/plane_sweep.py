"""Plane-sweep stereo (Collins 1996): planes move away from a camera, and where the other photographs, seen through such
a plane, look like its own, there is something. Only what two views agree on is believed."""

from __future__ import annotations

from itertools import chain

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from nerfreg import Photographs
from nerfreg.field.workers import in_shares
from nerfreg_plugins.stereo.semi_global import semi_global

FAINT = 3e-4
"""Variance of colour that is added to that of every window, so that noise alone does not match."""

NO_MATCH = 0.8
"""Cost, 1 - correlation, that no match is above: nothing there looks alike, or it is outside the other photograph."""

ALIKE = 0.5
"""Cost that a match must be below to be believed."""

FEWEST = 16
"""Planes that there are at least."""

NEAREST = 1e-3
"""The nearest plane, as a share of the farthest one's distance, where rays begin at 0."""


def plane_sweep(
    photographs: Photographs, width: int = 256, planes: int = 128, window: int = 7, sources: int = 4
) -> Float[Tensor, "views height width 2"]:
    """Between which distances along the ray of each pixel there is something, (V, H, W, 2).

    That is one pixel either way of where the sources show what the view shows, or one plane if those are further apart.
    NaN where no source agrees, and where alpha is below 1/2.

    width: to which the longer side of the photographs is reduced, about. planes: evenly spaced in inverse depth from
    near to far, half a pixel apart, but at most so many. window: side of what is compared, in reduced pixels.
    sources: how many nearest views each is compared with.
    """
    size = (photographs.cameras.height, photographs.cameras.width)
    factor = max(1, round(max(size) / width))
    views = _Reduced(photographs, factor, window, sources)
    nearest, farthest = 1 / max(photographs.near, NEAREST * photographs.far), 1 / photographs.far
    shift = max(1.0, *(float(_shift(views, view, nearest, farthest)) for view in range(len(views))))
    inverse = torch.linspace(nearest, farthest, min(max(round(2 * shift), FEWEST), planes))
    pixel = (nearest - farthest) / min(shift, len(inverse) - 1)

    def search(first: int, last: int) -> list[Tensor]:
        return [_inverse_depth(views, view, inverse) for view in range(first, last)]

    found = torch.stack(list(chain(*in_shares(len(views), 1, search))))
    agreed = torch.stack([_agreed(views, view, found, pixel) for view in range(len(views))])
    interval = 1 / torch.stack([found + pixel, (found - pixel).clamp_min(farthest)], dim=1)
    known = torch.where(agreed & views.opaque, 1 / views.cosines, torch.nan)[:, None] * interval
    rows, columns = (
        (torch.arange(full) // factor).clamp_max(reduced - 1)
        for full, reduced in zip(size, (views.height, views.width), strict=True)
    )
    return known.permute(0, 2, 3, 1)[:, rows][:, :, columns]


class _Reduced:
    """V photographs at 1 / factor of their size, (V, C, H, W), and the views that each is compared with.

    cosines: (V, H, W) between the rays and the optical axis.
    """

    def __init__(self, photographs: Photographs, factor: int, window: int, sources: int) -> None:
        images = photographs.images.permute(0, 3, 1, 2)
        if images.shape[1] == 4:
            images = torch.cat([images[:, :3] * images[:, 3:], images[:, 3:]], dim=1)
        self.images = functional.avg_pool2d(images, factor)
        self.opaque = self.images[:, 3] > 0.5 if images.shape[1] == 4 else torch.ones_like(self.images[:, 0]).bool()
        self.cameras, self.factor, self.margin = photographs.cameras, factor, window // 2
        self.height, self.width = self.images.shape[2:]
        self.size = torch.tensor([self.width, self.height])
        y, x = torch.meshgrid(torch.arange(self.height), torch.arange(self.width), indexing="ij")
        pixels = factor * (torch.stack([x, y], dim=-1).view(-1, 2) + 0.5)
        rays = [self.cameras.rays_through(torch.full((len(pixels),), view), pixels) for view in range(len(self))]
        cosines = [rays[view][1] @ self.cameras.axes[view] for view in range(len(self))]
        self._origins = [origins for origins, _ in rays]
        self._ahead = [ray[1] / cosine[:, None] for ray, cosine in zip(rays, cosines, strict=True)]
        self.cosines = torch.stack(cosines).view(-1, self.height, self.width)
        positions = self.cameras.positions
        self.sources = torch.cdist(positions, positions).argsort(stable=True)[:, 1 : sources + 1].tolist()
        self._in_window = self._sums(torch.ones(1, self.height, self.width))

    def __len__(self) -> int:
        return len(self.images)

    def mean(self, image: Float[Tensor, "channels height width"]) -> Float[Tensor, "channels height width"]:
        """Over the window around each pixel, as far as it lies in the image."""
        return self._sums(image) / self._in_window

    def points(self, view: int, inverse_depth: Tensor) -> Float[Tensor, "pixels 3"]:
        """Where the pixels are in the world, given their inverse depth along the optical axis, for all or for each."""
        return self._origins[view] + self._ahead[view] / inverse_depth.expand(len(self._ahead[view]))[:, None]

    def places(self, points: Float[Tensor, "pixels 3"], view: int) -> Float[Tensor, "pixels 2"]:
        """Where points appear in a view, (x, y) in reduced pixels; NaN behind the camera."""
        return self.cameras.project(points, view) / self.factor

    def _sums(self, image: Tensor) -> Tensor:
        # Added slice by slice: torch's pooling takes ten times as long.
        side, margin = 2 * self.margin + 1, self.margin
        padded = functional.pad(image, (margin, margin, margin, margin))
        rows = padded[:, : self.height].clone()
        for shift in range(1, side):
            rows += padded[:, shift : shift + self.height]
        sums = rows[:, :, : self.width].clone()
        for shift in range(1, side):
            sums += rows[:, :, shift : shift + self.width]
        return sums


def _shift(views: _Reduced, view: int, nearest: float, farthest: float) -> Float[Tensor, ""]:
    """By how many pixels what a source shows of a ray moves from the nearest plane to the farthest.

    The median over pixels, the largest over sources.
    """
    ends = [views.points(view, torch.tensor(inverse)) for inverse in (nearest, farthest)]
    shifts = [
        (views.places(ends[0], source) - views.places(ends[1], source)).norm(dim=-1) for source in views.sources[view]
    ]
    return torch.stack([torch.zeros(()), *(shift.nanmedian().nan_to_num(0.0) for shift in shifts)]).amax()


def _inverse_depth(views: _Reduced, view: int, inverse: Float[Tensor, " planes"]) -> Float[Tensor, "height width"]:
    """Inverse depth of each pixel along the optical axis, NaN where nothing is alike.

    The best plane, and by a parabola where between two.
    """
    cost = torch.full((views.height, views.width, len(inverse)), NO_MATCH)
    own = views.images[view]
    mean, square = views.mean(own), views.mean(own.square().sum(0, keepdim=True))[0]
    variance = square - mean.square().sum(0) + FAINT
    for plane, value in enumerate(inverse):
        points = views.points(view, value)
        for source in views.sources[view]:
            match = _mismatch(views, own, mean, variance, source, points)
            cost[..., plane] = torch.minimum(cost[..., plane], match)
    total = semi_global(cost)
    best = total.argmin(-1, keepdim=True).clamp(1, len(inverse) - 2)
    before, at, after = (total.gather(-1, best + step)[..., 0] for step in (-1, 0, 1))
    curvature = before - 2 * at + after
    shift = torch.where(curvature > 0, 0.5 * (before - after) / curvature, 0.0).clamp(-0.5, 0.5)
    found = torch.lerp(inverse[0], inverse[-1], (best[..., 0] + shift) / (len(inverse) - 1))
    return torch.where(cost.gather(-1, best)[..., 0] < ALIKE, found, torch.nan)


def _mismatch(
    views: _Reduced, own: Tensor, mean: Tensor, variance: Tensor, source: int, points: Float[Tensor, "pixels 3"]
) -> Float[Tensor, "height width"]:
    """1 - correlation of the windows around each pixel and around where its point appears in the source."""
    place = views.places(points, source) / views.size * 2 - 1
    inside = (place.abs() < 1).all(-1).view(views.height, views.width)
    grid = place.nan_to_num(2.0).view(1, views.height, views.width, 2)
    seen = functional.grid_sample(views.images[source][None], grid, padding_mode="border", align_corners=False)[0]
    sums = torch.cat([seen, seen.square().sum(0, keepdim=True), (own * seen).sum(0, keepdim=True)])
    means = views.mean(sums)
    seen_mean, square, product = means[:-2], means[-2], means[-1]
    seen_variance = square - seen_mean.square().sum(0) + FAINT
    common = product - (mean * seen_mean).sum(0)
    return torch.where(inside, 1 - common / (variance * seen_variance).sqrt(), NO_MATCH)


def _agreed(
    views: _Reduced, view: int, inverse_depth: Float[Tensor, "views height width"], gap: float
) -> Bool[Tensor, "height width"]:
    """Pixels whose point is, to within `gap` of inverse depth, where some source has one too."""
    points = views.points(view, inverse_depth[view].flatten())
    agreed = torch.zeros(len(points), dtype=torch.bool)
    for source in views.sources[view]:
        place = views.places(points, source).floor().nan_to_num(-1).long()
        inside = ((place >= 0) & (place < views.size)).all(-1)
        index: Int[Tensor, " pixels"] = torch.where(inside, place[:, 1] * views.width + place[:, 0], 0)
        depth = (points - views.cameras.positions[source]) @ views.cameras.axes[source]
        agreed |= inside & ((1 / depth - inverse_depth[source].flatten()[index]).abs() < gap)
    return agreed.view(views.height, views.width)
