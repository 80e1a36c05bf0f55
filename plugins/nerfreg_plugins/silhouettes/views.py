"""What each photograph shows of a silhouette, seen through a pinhole."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from nerfreg import Photographs
from nerfreg.scenes import lens
from nerfreg.scenes.cameras import Cameras


def silhouettes(
    photographs: Photographs, alpha: float
) -> Bool[Tensor, "views height width"] | None:
    """Return which pixels show matter; None if the photographs do not tell.

    Args:
        photographs: The photographs.
        alpha: Pixels of more alpha than this do.
    """
    if photographs.masks is not None:
        covered = photographs.masks
    elif photographs.images.shape[-1] == 4:
        covered = photographs.images[..., 3] > alpha
    else:
        return None
    # An alpha channel that is 1 everywhere tells nothing.
    everywhere = covered if photographs.valid is None else covered | ~photographs.valid
    return None if bool(everywhere.all()) else covered


@dataclass(frozen=True)
class PinholeView:
    """A silhouette without lens distortion, for questions about rectangles of its pixels.

    Attributes:
        position: (3,) of the camera.
        rotation: (3, 3) its axes right, down and forward, as columns.
        focal: (2,) in pixels.
        center: (2,) principal point in pixels.
        covered: (H+1, W+1) sums of covered pixels above and to the left of each corner.
        beyond: (H+1, W+1) sums of pixels outside of the photograph, likewise; None if there are
            none.
        open: Whether matter may lie outside of the photograph.
    """

    position: Float[Tensor, " 3"]
    rotation: Float[Tensor, "3 3"]
    focal: Float[Tensor, " 2"]
    center: Float[Tensor, " 2"]
    covered: Int[Tensor, "rows columns"]
    beyond: Int[Tensor, "rows columns"] | None
    open: bool

    @classmethod
    def of(
        cls,
        cameras: Cameras,
        view: int,
        covered: Bool[Tensor, "height width"],
        margin: float,
        frame: bool,
    ) -> PinholeView:
        """Prepare a silhouette.

        Args:
            cameras: All cameras.
            view: Which of them it is.
            covered: (H, W) which pixels show matter.
            margin: By how many pixels to grow the silhouette.
            frame: Whether there is nothing outside of the image if the silhouette does not touch
                its border.
        """
        border = torch.cat([covered[0], covered[-1], covered[:, 0], covered[:, -1]])
        focal, center = cameras.focal[view], cameras.center[view]
        beyond = None
        if cameras.distortion[view].any():
            covered, beyond, center = _undistorted(cameras, view, covered)
        reach = math.ceil(margin)
        if reach:
            covered = _grown(covered, reach)
            beyond = None if beyond is None else _grown(beyond, reach)
        pose = cameras.poses[view]
        return cls(
            pose[:, 3],
            pose[:, :3] * torch.tensor([1.0, -1.0, -1.0]),
            focal,
            center,
            _sums(covered),
            None if beyond is None else _sums(beyond),
            bool(border.any()) or not frame,
        )

    def may_show(self, centers: Float[Tensor, "cells 3"], half: float) -> Bool[Tensor, " cells"]:
        """Return which cubes, aligned with the axes of the world, the silhouette leaves possible.

        Those whose projection meets the silhouette, or may meet what the view does not show; never
        fewer.

        Args:
            centers: (P, 3) their centres.
            half: Half their sides.
        """
        x, y, depth = ((centers - self.position) @ self.rotation).unbind(dim=1)
        # How far cubes reach along the axes of the camera.
        half_x, half_y, half_depth = (half * self.rotation.abs().sum(dim=0)).tolist()
        front = depth - half_depth
        ahead = front > 1e-3 * half
        # (X + dx) / (Z + dz) differs from X / Z by (dx - dz X / Z) / (Z + dz).
        safe = torch.where(ahead, depth, torch.ones_like(depth))
        nearest = torch.where(ahead, front, torch.ones_like(depth))
        low, high = [], []
        for axis, (at, reach) in enumerate(((x, half_x), (y, half_y))):
            slope = at / safe
            middle = slope * self.focal[axis] + self.center[axis]
            around = self.focal[axis] * (reach + slope.abs() * half_depth) / nearest
            low.append(middle - around)
            high.append(middle + around)
        rows, columns = (n - 1 for n in self.covered.shape)
        inside = (low[0] >= 0) & (low[1] >= 0) & (high[0] <= columns) & (high[1] <= rows)
        corners = (
            *((bound.floor().clamp(0, columns)).int() for bound in (low[0], high[0] + 1)),
            *((bound.floor().clamp(0, rows)).int() for bound in (low[1], high[1] + 1)),
        )
        possible: Tensor = ahead & (_within(self.covered, *corners) > 0)
        # What lies at the plane of the camera cannot be projected; what lies behind is not shown.
        possible |= ~ahead & (depth + half_depth > 0)
        if self.open:
            possible |= ~inside | (depth + half_depth <= 0)
            if self.beyond is not None:
                possible |= _within(self.beyond, *corners) > 0
        return possible


def _undistorted(
    cameras: Cameras, view: int, covered: Bool[Tensor, "height width"]
) -> tuple[Tensor, Tensor, Tensor]:
    """Return a silhouette as a pinhole camera of the same focal lengths would show it.

    Returns:
        (H', W') which pixels are covered, (H', W') which lie outside of the photograph, and (2,)
        the principal point.
    """
    height, width = covered.shape
    x, y = torch.arange(width + 1.0), torch.arange(height + 1.0)
    edge = torch.cat(
        [
            torch.stack([line, torch.full_like(line, end)], dim=1)
            for line, end in ((x, 0.0), (x, float(height)))
        ]
        + [
            torch.stack([torch.full_like(line, end), line], dim=1)
            for line, end in ((y, 0.0), (y, float(width)))
        ]
    )
    focal, center = cameras.focal[view], cameras.center[view]
    coefficients = cameras.distortion[view]
    ideal = lens.undistort((edge - center) / focal, coefficients.expand(len(edge), 5)) * focal
    low, high = ideal.amin(dim=0).floor(), ideal.amax(dim=0).ceil()
    columns, rows = (int(n) for n in high - low)
    grid = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    points = torch.stack([grid[1], grid[0]], dim=-1).view(-1, 2) + 0.5 + low
    shown = lens.distort(points / focal, coefficients.expand(len(points), 5)) * focal + center
    # A pixel more, because pixels of both images do not cover each other.
    u, v = shown.floor().long().unbind(dim=1)
    outside = (u < 0) | (v < 0) | (u >= width) | (v >= height)
    found = _grown(covered, 1)[v.clamp(0, height - 1), u.clamp(0, width - 1)] & ~outside
    return found.view(rows, columns), outside.view(rows, columns), -low


def _grown(mask: Bool[Tensor, "height width"], reach: int) -> Bool[Tensor, "height width"]:
    pooled: Tensor = functional.max_pool2d(mask[None, None].float(), 2 * reach + 1, 1, reach)
    return pooled[0, 0] > 0


def _sums(mask: Bool[Tensor, "height width"]) -> Int[Tensor, "rows columns"]:
    """Sums over all pixels above and to the left of each corner."""
    sums: Tensor = functional.pad(mask.int().cumsum(0).cumsum(1), (1, 0, 1, 0))
    return sums.int()


def _within(
    sums: Int[Tensor, "rows columns"], left: Tensor, right: Tensor, top: Tensor, bottom: Tensor
) -> Int[Tensor, " cells"]:
    """Sums over rectangles of pixels, from the sums at their corners."""
    flat, width = sums.view(-1), sums.shape[1]
    return (
        flat[bottom * width + right]
        - flat[top * width + right]
        - flat[bottom * width + left]
        + flat[top * width + left]
    )
