"""Photographs as stereo sees them: undistorted, reduced, each with its nearest other views."""

from __future__ import annotations

import dataclasses

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from nerfreg import Photographs
from nerfreg.scenes import lens
from nerfreg.scenes.cameras import Cameras


class PinholeViews:
    """V photographs without lens distortion at 1 / factor of their size.

    Attributes:
        images: `(V, H, W, C)`; colours are premultiplied by alpha where there is one, the fourth
            channel.
        opaque: Pixels with an alpha above 1/2, `(V, H, W)`.
        cameras: Of the photographs at their full size.
        factor: By which width and height are reduced.
        sources: The views that each view is compared with, nearest first.
    """

    def __init__(self, photographs: Photographs, factor: int, sources: int) -> None:
        images = photographs.images
        # What is transparent may have any colour, which must not be mixed into its neighbours.
        if images.shape[-1] == 4:
            images = torch.cat([images[..., :3] * images[..., 3:], images[..., 3:]], dim=-1)
        # Rounded up, so that every pixel of a photograph has a reduced one.
        pooled = functional.avg_pool2d(images.permute(0, 3, 1, 2), factor, ceil_mode=True)
        self.images = pooled.permute(0, 2, 3, 1).contiguous()
        self.opaque = torch.ones(self.images.shape[:3], dtype=torch.bool)
        if images.shape[-1] == 4:
            self.opaque = self.images[..., 3] > 0.5
        self.cameras, self.factor = photographs.cameras, factor
        positions = self.cameras.positions
        # Stable, so that ties are broken alike everywhere; the nearest view is the view itself.
        nearest = torch.cdist(positions, positions).argsort(stable=True)
        self.sources = nearest[:, 1 : sources + 1].tolist()

    def __len__(self) -> int:
        return len(self.images)

    def projection(
        self, view: int, source: int
    ) -> tuple[Float[Tensor, "height width 3"], Float[Tensor, " 3"]]:
        """Return what projects the pixels of a view into a source, given their inverse depth.

        Returns:
            (at_infinity, epipole): the point of a pixel at inverse depth w appears in the source at
            (x / z, y / z) of (x, y, z) = at_infinity + w epipole, in reduced pixels. z / w is its
            depth there. Depths are along the optical axes.
        """
        height, width = self.opaque.shape[1:]
        pixels = self.factor * (pixel_indices(height, width).view(-1, 2) + 0.5)
        directions = self.cameras.rays_through(torch.full((len(pixels),), view), pixels)[1]
        # As long as it takes to be at depth 1 along the optical axis.
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

    def disparity(self, nearest: float, farthest: float) -> float:
        """Return by how many pixels what a source shows of a ray moves along the whole ray.

        The median over pixels, the largest over views and sources; at least 1.

        Args:
            nearest: Inverse depth at which a ray begins.
            farthest: Inverse depth at which it ends.
        """
        shifts = [1.0]
        for view, sources in enumerate(self.sources):
            for source in sources:
                at_infinity, epipole = self.projection(view, source)
                near, far = (
                    projected(at_infinity + inverse * epipole) for inverse in (nearest, farthest)
                )
                shifts.append(float((near - far).norm(dim=-1).nanmedian().nan_to_num(0.0)))
        return max(shifts)

    def consistent(
        self, view: int, inverse_depth: Float[Tensor, "views height width"], gap: float
    ) -> Float[Tensor, "height width"]:
        """Return the inverse depths of a view that some source agrees with, and NaN elsewhere.

        Args:
            view: Which view.
            inverse_depth: Of all views; NaN where there is none.
            gap: How far two inverse depths of one surface may differ.
        """
        own = inverse_depth[view]
        agreed = torch.zeros_like(own, dtype=torch.bool)
        for source in self.sources[view]:
            at_infinity, epipole = self.projection(view, source)
            there = at_infinity + own[..., None] * epipole
            theirs = looked_up(inverse_depth[source], projected(there))
            # own / z is the inverse depth along the axis of the source. NaN agrees with nothing.
            agreed |= (own / there[..., 2] - theirs).abs() < gap
        return torch.where(agreed & self.opaque[view], own, torch.nan)


def pixel_indices(height: int, width: int) -> Int[Tensor, "height width 2"]:
    """Return (x, y) of all pixels of an image."""
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return torch.stack([x, y], dim=-1)


def projected(point: Float[Tensor, "*many 3"]) -> Float[Tensor, "*many 2"]:
    """Return (x / z, y / z); NaN behind the camera."""
    return point[..., :2] / torch.where(point[..., 2:] > 0, point[..., 2:], torch.nan)


def looked_up(
    image: Float[Tensor, "height width *more"], places: Float[Tensor, "*many 2"]
) -> Tensor:
    """Return what the pixels at places (x, y) hold; NaN outside."""
    height, width = image.shape[:2]
    x, y = places.floor().nan_to_num(-1).unbind(-1)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    held = image[torch.where(inside, y, 0).long(), torch.where(inside, x, 0).long()]
    return torch.where(
        inside.view(*inside.shape, *[1] * (held.dim() - inside.dim())), held, torch.nan
    )


def without_distortion(photographs: Photographs) -> Photographs:
    """Return what the cameras would have seen through straight lenses."""
    cameras = photographs.cameras
    if not cameras.distortion.any():
        return photographs
    height, width = photographs.images.shape[1:3]
    middles = pixel_indices(height, width).view(-1, 2) + 0.5
    size = torch.tensor([width, height])
    grid = []
    for focal, center, distortion in zip(
        cameras.focal, cameras.center, cameras.distortion, strict=True
    ):
        # Each pixel of the straight image is looked up where the lens has put it, which needs no
        # inverse of the distortion.
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


def along_rays(
    inverse_depth: Float[Tensor, "height width 2"], cameras: Cameras, view: int, factor: int
) -> Float[Tensor, "full_height full_width 2"]:
    """Return distances along the rays of all pixels of a photograph.

    Args:
        inverse_depth: Of the reduced photograph without distortion.
        cameras: Of the photographs as they are, with distortion.
        view: Which of them.
        factor: By which the photograph was reduced.
    """
    directions = cameras.image_rays(view)[1]
    # In the camera's own axes, which look along -z: -z is the cosine to the optical axis.
    local = directions @ cameras.poses[view, :, :3]
    straight = (
        local[:, :2] * torch.tensor([1.0, -1.0]) / -local[:, 2:] * cameras.focal[view]
        + cameras.center[view]
    )
    found = looked_up(inverse_depth, straight / factor)
    return (1 / (found * -local[:, 2:])).view(cameras.height, cameras.width, 2)
