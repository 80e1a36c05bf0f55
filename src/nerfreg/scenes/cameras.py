"""Cameras: intrinsics, distortion and poses of all views, and the rays through their pixels."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from nerfreg.scenes import lens


@dataclass(frozen=True)
class Cameras:
    """V pinhole cameras with OpenCV lens distortion, whose images all have the same size.

    Attributes:
        width: Width of the images in pixels.
        height: Height of the images in pixels.
        poses: Camera-to-world matrices, `(V, 3, 4)`, with OpenGL axes: x right, y up, looking along
            -z.
        focal: Focal lengths fx, fy in pixels, `(V, 2)`.
        center: Principal points cx, cy in pixels, `(V, 2)`; the centre of the top left pixel is at
            (0.5, 0.5).
        distortion: Coefficients k1, k2, p1, p2, k3 (OpenCV's order), `(V, 5)`.
    """

    width: int
    height: int
    poses: Float[Tensor, "views 3 4"]
    focal: Float[Tensor, "views 2"]
    center: Float[Tensor, "views 2"]
    distortion: Float[Tensor, "views 5"]

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.poses)

    def of(self, views: Sequence[int]) -> Cameras:
        """Select views, which are numbered from 0 in the given order."""
        index = list(views)
        parts = {
            name: getattr(self, name)[index] for name in ("poses", "focal", "center", "distortion")
        }
        return dataclasses.replace(self, **parts)

    @property
    def positions(self) -> Float[Tensor, "views 3"]:
        """Positions of the cameras in the world, `(V, 3)`."""
        return self.poses[:, :, 3]

    @property
    def axes(self) -> Float[Tensor, "views 3"]:
        """Unit directions of the optical axes, `(V, 3)`."""
        # Poses from files are orthonormal to a tolerance only.
        return functional.normalize(-self.poses[:, :, 2], dim=-1)

    def rays(
        self, views: Int[Tensor, " rays"], pixels: Int[Tensor, "rays 2"]
    ) -> tuple[Float[Tensor, "rays 3"], Float[Tensor, "rays 3"]]:
        """Compute the rays through the centres of pixels.

        Args:
            views: The view of each ray, `(R,)`.
            pixels: Pixels (x, y), `(R, 2)`.

        Returns:
            Origins and unit directions, `(R, 3)` each.
        """
        return self.rays_through(views, pixels + 0.5)

    def rays_through(
        self, views: Int[Tensor, " rays"], points: Float[Tensor, "rays 2"]
    ) -> tuple[Float[Tensor, "rays 3"], Float[Tensor, "rays 3"]]:
        """Compute the rays through points of the images.

        Args:
            views: The view of each ray, `(R,)`.
            points: Points (x, y) in pixels, `(R, 2)`.

        Returns:
            Origins and unit directions, `(R, 3)` each.
        """
        xy = (points - self.center[views]) / self.focal[views]
        if self.distortion.any():
            xy = lens.undistort(xy, self.distortion[views])
        x, y = xy.unbind(-1)
        poses = self.poses[views]
        # Image coordinates point down and forward (OpenCV), camera axes up and backward (OpenGL).
        local = torch.stack((x, -y, -torch.ones_like(x)), -1)
        directions = functional.normalize((poses[:, :, :3] @ local[:, :, None])[..., 0], dim=-1)
        return poses[:, :, 3], directions

    def image_rays(self, view: int) -> tuple[Float[Tensor, "rays 3"], Float[Tensor, "rays 3"]]:
        """Compute the rays through all pixels of a view.

        Args:
            view: The view.

        Returns:
            Origins and unit directions, `(H * W, 3)` each, row by row.
        """
        y, x = torch.meshgrid(torch.arange(self.height), torch.arange(self.width), indexing="ij")
        pixels = torch.stack((x, y), -1).reshape(-1, 2)
        return self.rays(torch.full((len(pixels),), view), pixels)

    def project(self, points: Float[Tensor, "points 3"], view: int) -> Float[Tensor, "points 2"]:
        """Project points of the world into a view.

        Args:
            points: World positions, `(P, 3)`.
            view: The view.

        Returns:
            Points (x, y) in pixels, `(P, 2)`; NaN for points behind the camera.
        """
        pose = self.poses[view]
        local = (points - pose[:, 3]) @ pose[:, :3]
        depth = -local[:, 2:]
        xy = local[:, :2] * torch.tensor([1.0, -1.0]) / torch.where(depth > 0, depth, torch.nan)
        if self.distortion[view].any():
            xy = lens.distort(xy, self.distortion[view].expand(len(xy), 5))
        return xy * self.focal[view] + self.center[view]
