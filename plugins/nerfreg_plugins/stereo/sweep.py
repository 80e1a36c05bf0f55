"""Plane-sweep stereo (Collins 1996): planes move away from a camera, and where the other photographs, seen through such
a plane, look like its own, there is something. Only what two views agree on is believed."""

from __future__ import annotations

from itertools import chain

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from nerfreg import Photographs
from nerfreg.field.workers import in_shares
from nerfreg_plugins.stereo.matching import NO_MATCH, lower_cost
from nerfreg_plugins.stereo.semi_global import semi_global

ALIKE = 0.5
"""Cost that a match must be below to be believed."""

FEWEST = 16
"""Planes that there are at least."""

NEAREST = 1e-3
"""The nearest plane, as a share of the farthest one's distance, where rays begin at 0."""

Part = tuple[slice, slice]
"""Rows and columns."""


def plane_sweep(
    photographs: Photographs, width: int = 512, planes: int = 128, window: int = 7, sources: int = 4
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
    views = _Reduced(photographs, factor, window // 2, sources)
    nearest, farthest = 1 / max(photographs.near, NEAREST * photographs.far), 1 / photographs.far
    shift = max(1.0, *(float(_shift(views, view, nearest, farthest)) for view in range(len(views))))
    inverse = torch.linspace(nearest, farthest, min(max(round(2 * shift), FEWEST), planes))
    pixel = (nearest - farthest) / min(shift, len(inverse) - 1)

    def search(first: int, last: int) -> list[Tensor]:
        return [_inverse_depth(views, view, inverse) for view in range(first, last)]

    found = torch.stack(list(chain(*in_shares(len(views), 1, search))))
    agreed = torch.stack([_agreed(views, view, found, pixel) for view in range(len(views))])
    interval = 1 / torch.stack([found + pixel, (found - pixel).clamp_min(farthest)], dim=-1)
    known = torch.where(agreed & views.opaque, 1 / views.cosines, torch.nan)[..., None] * interval
    rows, columns = (
        (torch.arange(full) // factor).clamp_max(reduced - 1)
        for full, reduced in zip(size, (views.height, views.width), strict=True)
    )
    return known[:, rows][:, :, columns]


class _Reduced:
    """V photographs at 1 / factor of their size, and the views that each is compared with.

    images: (V, H, W, C). opaque: (V, H, W). cosines: (V, H, W) between the rays and the optical axis.
    """

    def __init__(self, photographs: Photographs, factor: int, margin: int, sources: int) -> None:
        images = photographs.images
        if images.shape[-1] == 4:
            images = torch.cat([images[..., :3] * images[..., 3:], images[..., 3:]], dim=-1)
        self.images = functional.avg_pool2d(images.permute(0, 3, 1, 2), factor).permute(0, 2, 3, 1).contiguous()
        self.opaque = torch.ones(self.images.shape[:3], dtype=torch.bool)
        if images.shape[-1] == 4:
            self.opaque = self.images[..., 3] > 0.5
        self.cameras, self.factor, self.margin = photographs.cameras, factor, margin
        self.height, self.width = self.images.shape[1:3]
        y, x = torch.meshgrid(torch.arange(self.height), torch.arange(self.width), indexing="ij")
        pixels = factor * (torch.stack([x, y], dim=-1).view(-1, 2) + 0.5)
        rays = [self.cameras.rays_through(torch.full((len(pixels),), view), pixels) for view in range(len(self))]
        origins, directions = (torch.stack(parts).view(*self.opaque.shape, 3) for parts in zip(*rays, strict=True))
        self.cosines = (directions * self.cameras.axes[:, None, None]).sum(-1)
        self._origins, self._ahead = origins, directions / self.cosines[..., None]
        positions = self.cameras.positions
        self.sources = torch.cdist(positions, positions).argsort(stable=True)[:, 1 : sources + 1].tolist()

    def __len__(self) -> int:
        return len(self.images)

    def occupied(self, view: int) -> Part:
        """Where all opaque pixels of a view are, and a window's margin around them."""
        pixels = self.opaque[view].nonzero()
        if len(pixels) == 0:
            return slice(0, 0), slice(0, 0)
        first, last = (pixels.amin(0) - self.margin).clamp_min(0).tolist(), (pixels.amax(0) + self.margin + 1).tolist()
        return slice(first[0], last[0]), slice(first[1], last[1])

    def points(self, view: int, part: Part, inverse_depth: Tensor) -> Float[Tensor, "height width 3"]:
        """Where pixels are in the world, given their inverse depth along the optical axis, for all or for each."""
        return self._origins[view][part] + self._ahead[view][part] / inverse_depth[..., None]

    def places(self, points: Float[Tensor, "height width 3"], view: int) -> Float[Tensor, "height width 2"]:
        """Where points appear in a view, (x, y) in reduced pixels; NaN behind the camera."""
        return (self.cameras.project(points.reshape(-1, 3), view) / self.factor).view(*points.shape[:2], 2)


ALL = slice(None), slice(None)


def _shift(views: _Reduced, view: int, nearest: float, farthest: float) -> Float[Tensor, ""]:
    """By how many pixels what a source shows of a ray moves from the nearest plane to the farthest.

    The median over pixels, the largest over sources.
    """
    ends = [views.points(view, ALL, torch.tensor(inverse)) for inverse in (nearest, farthest)]
    shifts = [
        (views.places(ends[0], source) - views.places(ends[1], source)).norm(dim=-1) for source in views.sources[view]
    ]
    return torch.stack([torch.zeros(()), *(shift.nanmedian().nan_to_num(0.0) for shift in shifts)]).amax()


def _inverse_depth(views: _Reduced, view: int, inverse: Float[Tensor, " planes"]) -> Float[Tensor, "height width"]:
    """Inverse depth of each pixel along the optical axis, NaN where nothing is alike.

    The best plane, and by a parabola where between two.
    """
    part = views.occupied(view)
    own = views.images[view][part].contiguous()
    cost = torch.full((len(inverse), *own.shape[:2]), NO_MATCH)
    for plane, value in enumerate(inverse):
        points = views.points(view, part, value)
        for source in views.sources[view]:
            places, other = views.places(points, source), views.images[source]
            lower_cost(own.numpy(), other.numpy(), places.numpy(), views.margin, cost[plane].numpy())
    cost = cost.permute(1, 2, 0).contiguous()
    total = semi_global(cost)
    best = total.argmin(-1, keepdim=True).clamp(1, len(inverse) - 2)
    before, at, after = (total.gather(-1, best + step)[..., 0] for step in (-1, 0, 1))
    curvature = before - 2 * at + after
    shift = torch.where(curvature > 0, 0.5 * (before - after) / curvature, 0.0).clamp(-0.5, 0.5)
    found = torch.full((views.height, views.width), torch.nan)
    between = torch.lerp(inverse[0], inverse[-1], (best[..., 0] + shift) / (len(inverse) - 1))
    found[part] = torch.where(cost.gather(-1, best)[..., 0] < ALIKE, between, torch.nan)
    return found


def _agreed(
    views: _Reduced, view: int, inverse_depth: Float[Tensor, "views height width"], gap: float
) -> Bool[Tensor, "height width"]:
    """Pixels whose point is, to within `gap` of inverse depth, where some source has one too."""
    points = views.points(view, ALL, inverse_depth[view])
    agreed = torch.zeros(points.shape[:2], dtype=torch.bool)
    for source in views.sources[view]:
        x, y = views.places(points, source).floor().nan_to_num(-1).long().unbind(-1)
        inside = (x >= 0) & (x < views.width) & (y >= 0) & (y < views.height)
        depth = (points - views.cameras.positions[source]) @ views.cameras.axes[source]
        theirs = inverse_depth[source][torch.where(inside, y, 0), torch.where(inside, x, 0)]
        agreed |= inside & ((1 / depth - theirs).abs() < gap)
    return agreed
