"""Camera paths for videos, derived from the training cameras alone."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from nerfreg.scenes.bounds import look_at_point
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.poses import look_at, pose
from nerfreg.scenes.scene import Scene


def spiral_path(scene: Scene, frames: int) -> Cameras:
    """Make a closed spiral in front of a forward-facing scene, always looking at one point.

    It makes two turns through the part of space that the training cameras span, around their mean
    pose. The point is straight ahead, where disparity is midway between those at near and far.

    Args:
        scene: The scene.
        frames: Number of frames.

    Returns:
        The cameras of all frames, with the intrinsics of the first training view.
    """
    poses = _training_poses(scene)
    center, up, back = poses[:, :, 3].mean(0), poses[:, :, 1].mean(0), poses[:, :, 2].mean(0)
    frame = pose(back, up, center)[:, :3]
    # The harmonic mean of near and far; the bound keeps a near of 0 from pulling the point to 0.
    distance = 2.0 / (1.0 / max(scene.near, 1e-2 * scene.far) + 1.0 / scene.far)
    target = center - distance * frame[:, 2]
    # A single camera spans nothing: let it sway by a few hundredths of the distance instead.
    extent = ((poses[:, :, 3] - center) @ frame).abs().amax(0).clamp_min(0.03 * distance)
    # Not beyond half the way to the point, or the camera would run into what it looks at.
    extent[2] = extent[2].clamp_max(0.5 * distance)
    origins = []
    for i in range(frames):
        angle = 4 * math.pi * i / frames
        # Forward and back once over two turns around, so that the path closes.
        offset = torch.tensor(
            [math.cos(angle), math.sin(angle), math.sin(angle / 2)], dtype=poses.dtype
        )
        origins.append(center + frame @ (offset * extent))
    return _cameras(scene, [look_at(origin, target, up) for origin in origins])


def orbit_path(scene: Scene, frames: int) -> Cameras:
    """Make a closed circle around what the training cameras look at.

    It goes around the point nearest to all optical axes, about the direction that is up in the
    photographs, at the mean radius and height of the training cameras, and starts where the first
    of them is.

    Args:
        scene: The scene.
        frames: Number of frames.

    Returns:
        The cameras of all frames, with the intrinsics of the first training view.
    """
    poses = _training_poses(scene)
    target, up = look_at_point(scene.cameras, scene.train, scene.box.mean(0)), upright(poses)
    offsets = poses[:, :, 3] - target
    heights = offsets @ up
    flat = offsets - heights[:, None] * up
    # Cameras right above the point have no radius; a circle of a tenth of their distance is shown
    # then.
    radius = torch.maximum(flat.norm(dim=-1).mean(), 0.1 * offsets.norm(dim=-1).mean())
    # Where the first camera is right above or below, the horizontal part of its own axes tells the
    # side: one of the two axes is not vertical.
    sideways = flat[0] if flat[0].norm() > 1e-3 * radius else poses[0, :, 2] + poses[0, :, 1]
    forward = functional.normalize(sideways - (sideways @ up) * up, dim=0)
    right = torch.linalg.cross(up, forward)
    origins = []
    for i in range(frames):
        angle = 2 * math.pi * i / frames
        circle = math.cos(angle) * forward + math.sin(angle) * right
        origins.append(target + radius * circle + heights.mean() * up)
    return _cameras(scene, [look_at(origin, target, up) for origin in origins])


def upright(poses: Float[Tensor, "views 3 4"]) -> Float[Tensor, " 3"]:
    """Find the direction that points up in the photographs.

    Cameras that are not rolled have horizontal x axes, so it is orthogonal to all of them. Where
    these do not differ enough to tell, it is the mean y axis.

    Args:
        poses: Camera-to-world matrices.

    Returns:
        The direction, of unit length.
    """
    right, mean_up = poses[:, :, 0], functional.normalize(poses[:, :, 1].mean(0), dim=0)
    eigenvalues, directions = torch.linalg.eigh(right.T @ right / len(poses))
    # The direction that is most nearly orthogonal to all x axes. It is clear if these spread over a
    # plane (the second eigenvalue, of a sum of 1) and hardly leave it (the smallest one).
    smallest, second = eigenvalues[0], eigenvalues[1]
    if second < 0.02 or smallest > 0.5 * second:
        return mean_up
    # An eigenvector has no sign.
    upward: Tensor = directions[:, 0]
    return upward if upward @ mean_up >= 0 else -upward


def _training_poses(scene: Scene) -> Float[Tensor, "views 3 4"]:
    return scene.cameras.poses[list(scene.train)]


def _cameras(scene: Scene, poses: list[Float[Tensor, "3 4"]]) -> Cameras:
    cameras, first = scene.cameras, scene.train[0]

    def repeat(intrinsics: Tensor) -> Tensor:
        return intrinsics[first].expand(len(poses), -1).clone()

    focal, center, distortion = (
        repeat(cameras.focal),
        repeat(cameras.center),
        repeat(cameras.distortion),
    )
    return Cameras(cameras.width, cameras.height, torch.stack(poses), focal, center, distortion)
