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
from nerfreg_plugins.silhouettes.projection import exclude_cubes


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
    valid = photographs.valid
    if valid is None:
        valid = torch.ones_like(covered)
    covered = covered & valid
    # An alpha channel that is the same everywhere tells nothing.
    return covered if bool(covered.any()) and bool((valid & ~covered).any()) else None


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
            frame: Whether there is nothing outside of the image if the silhouette, grown, does not
                touch its border.
        """
        reach = math.ceil(margin)
        covered = _grown(covered, reach) if reach else covered
        border = torch.cat([covered[0], covered[-1], covered[:, 0], covered[:, -1]])
        center, beyond = cameras.center[view], None
        if cameras.distortion[view].any():
            covered, beyond, center = _undistorted(cameras, view, covered)
        pose = cameras.poses[view]
        return cls(
            pose[:, 3],
            pose[:, :3] * torch.tensor([1.0, -1.0, -1.0]),
            cameras.focal[view],
            center,
            _sums(covered),
            None if beyond is None else _sums(beyond),
            bool(border.any()) or not frame,
        )

    def exclude(
        self, possible: Bool[Tensor, " cells"], centers: Float[Tensor, "cells 3"], half: float
    ) -> None:
        """Set to False which cubes, aligned with the axes of the world, the silhouette rules out.

        Never one whose projection meets the silhouette, or may meet what the view does not show. A
        projection is taken for the rectangle around that of a box along the axes of the camera,
        which contains the cube.

        Args:
            possible: (P,) which cubes are asked about; changed in place.
            centers: (P, 3) their centres, in double.
            half: Half their sides.
        """
        beyond = self.covered if self.beyond is None else self.beyond
        exclude_cubes(
            centers.numpy(),
            float(half),
            *(
                part.double().contiguous().numpy()
                for part in (self.position, self.rotation, self.focal, self.center)
            ),
            self.covered.numpy(),
            beyond.numpy(),
            self.beyond is not None,
            self.open,
            possible.numpy(),
        )


def _undistorted(
    cameras: Cameras, view: int, covered: Bool[Tensor, "height width"]
) -> tuple[Tensor, Tensor, Tensor]:
    """Return a silhouette as a pinhole camera of the same focal lengths would show it.

    Returns:
        (H', W') which pixels meet the silhouette, (H', W') which meet what is outside of the
        photograph, and (2,) the principal point.
    """
    height, width = covered.shape
    focal, center = cameras.focal[view], cameras.center[view]
    coefficients = cameras.distortion[view]
    edge = _edge(height, width)
    ideal = lens.undistort((edge - center) / focal, coefficients.expand(len(edge), 5)) * focal
    # A pixel more all around, for what the border does between the points that are looked at.
    low, high = ideal.amin(dim=0).floor() - 1, ideal.amax(dim=0).ceil() + 1
    columns, rows = (int(n) for n in high - low)
    grid = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    points = torch.stack([grid[1], grid[0]], dim=-1).view(-1, 2) + 0.5 + low
    coefficients = coefficients.expand(len(points), 5)
    distorted = lens.distort(points / focal, coefficients)
    shown = distorted * focal + center
    u, v = shown.floor().long().unbind(dim=1)
    # Far outside, the formula may fold back into the photograph, which shows nothing of this.
    again = lens.undistort(distorted, coefficients) * focal
    folded = ~((again - points).abs() < 0.5).all(dim=1)
    outside = folded | (u < 0) | (v < 0) | (u >= width) | (v >= height)
    reach = _reach(shown.view(rows, columns, 2), outside.view(rows, columns))
    # With room on all sides, since the centre of a pixel that the border crosses may lie outside.
    room = reach + 1
    grown = _grown(functional.pad(covered, (room,) * 4), reach)
    u, v = ((at + room).clamp(0, n + 2 * room - 1) for at, n in ((u, width), (v, height)))
    found = grown[v, u] & ~folded
    # Likewise, or it may lie inside.
    return found.view(rows, columns), _grown(outside.view(rows, columns), 1), -low


def _edge(height: int, width: int) -> Float[Tensor, "points 2"]:
    """Points on the border of an image, a pixel apart."""
    x, y = torch.arange(width + 1.0), torch.arange(height + 1.0)
    return torch.cat(
        [torch.stack([x, torch.full_like(x, end)], dim=1) for end in (0.0, float(height))]
        + [torch.stack([torch.full_like(y, end), y], dim=1) for end in (0.0, float(width))]
    )


def _reach(shown: Float[Tensor, "rows columns 2"], outside: Bool[Tensor, "rows columns"]) -> int:
    """How many pixels of a photograph away from a pixel's centre its corners may be shown.

    Args:
        shown: Where the photograph shows the centres of pixels.
        outside: Which of them it does not show.
    """
    spans = []
    for axis in (0, 1):
        count = shown.shape[axis] - 1
        ahead, here = shown.narrow(axis, 1, count), shown.narrow(axis, 0, count)
        both = ~(outside.narrow(axis, 1, count) | outside.narrow(axis, 0, count))
        steps = (ahead - here).abs()[both]
        spans.append(float(steps.max()) if len(steps) else 1.0)
    # Half of both steps, and a tenth for the curvature of the lens. A pixel that is met within this
    # distance is at most so many, rounded down after adding 1, from that of the centre.
    return math.floor(1 + 1.1 * sum(spans) / 2)


def _grown(mask: Bool[Tensor, "height width"], reach: int) -> Bool[Tensor, "height width"]:
    pooled: Tensor = functional.max_pool2d(mask[None, None].float(), 2 * reach + 1, 1, reach)
    return pooled[0, 0] > 0


def _sums(mask: Bool[Tensor, "height width"]) -> Int[Tensor, "rows columns"]:
    """Sums over all pixels above and to the left of each corner."""
    sums: Tensor = functional.pad(mask.int().cumsum(0).cumsum(1), (1, 0, 1, 0))
    return sums.int()
