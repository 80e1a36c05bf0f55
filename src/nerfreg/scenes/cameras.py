"""Cameras: intrinsics, lens distortion and pose of every view, and the rays through their pixels."""

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
    """V pinhole cameras with OpenCV lens distortion; all images have the same size.

    poses: (V, 3, 4) camera to world; x right, y up, looking along -z (OpenGL axes).
    focal, center: (V, 2) fx, fy and cx, cy in pixels; the centre of the top left pixel is (0.5, 0.5).
    distortion: (V, 5) k1, k2, p1, p2, k3 (OpenCV's order).
    """

    width: int
    height: int
    poses: Float[Tensor, "views 3 4"]
    focal: Float[Tensor, "views 2"]
    center: Float[Tensor, "views 2"]
    distortion: Float[Tensor, "views 5"]

    def __len__(self) -> int:
        return len(self.poses)

    def of(self, views: Sequence[int]) -> Cameras:
        """Some of the views, numbered from 0 in the order given."""
        index = list(views)
        parts = {
            name: getattr(self, name)[index] for name in ("poses", "focal", "center", "distortion")
        }
        return dataclasses.replace(self, **parts)

    @property
    def positions(self) -> Float[Tensor, "views 3"]:
        """Where the cameras stand."""
        return self.poses[:, :, 3]

    @property
    def axes(self) -> Float[Tensor, "views 3"]:
        """The directions in which they look, of unit length."""
        return functional.normalize(-self.poses[:, :, 2], dim=-1)

    def rays(
        self, views: Int[Tensor, " rays"], pixels: Int[Tensor, "rays 2"]
    ) -> tuple[Float[Tensor, "rays 3"], Float[Tensor, "rays 3"]]:
        """Origins and unit directions, (R, 3) each, through the centres of pixels (x, y)."""
        return self.rays_through(views, pixels + 0.5)

    def rays_through(
        self, views: Int[Tensor, " rays"], points: Float[Tensor, "rays 2"]
    ) -> tuple[Float[Tensor, "rays 3"], Float[Tensor, "rays 3"]]:
        """Origins and unit directions, (R, 3) each, through points (x, y) of the images, in pixels."""
        xy = (points - self.center[views]) / self.focal[views]
        if self.distortion.any():
            xy = lens.undistort(xy, self.distortion[views])
        x, y = xy.unbind(-1)
        poses = self.poses[views]
        local = torch.stack((x, -y, -torch.ones_like(x)), -1)
        directions = functional.normalize((poses[:, :, :3] @ local[:, :, None])[..., 0], dim=-1)
        return poses[:, :, 3], directions

    def image_rays(self, view: int) -> tuple[Float[Tensor, "rays 3"], Float[Tensor, "rays 3"]]:
        """Origins and unit directions, (H * W, 3) each, through all pixels of a view, row by row."""
        y, x = torch.meshgrid(torch.arange(self.height), torch.arange(self.width), indexing="ij")
        pixels = torch.stack((x, y), -1).reshape(-1, 2)
        return self.rays(torch.full((len(pixels),), view), pixels)

    def project(self, points: Float[Tensor, "points 3"], view: int) -> Float[Tensor, "points 2"]:
        """Where points of the world appear in a view, (x, y) in pixels; NaN behind the camera."""
        pose = self.poses[view]
        local = (points - pose[:, 3]) @ pose[:, :3]
        depth = -local[:, 2:]
        xy = local[:, :2] * torch.tensor([1.0, -1.0]) / torch.where(depth > 0, depth, torch.nan)
        if self.distortion[view].any():
            xy = lens.distort(xy, self.distortion[view].expand(len(xy), 5))
        return xy * self.focal[view] + self.center[view]
