"""Camera paths for films, derived from the training cameras alone."""

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
    """A closed spiral in front of a forward-facing scene, two turns, always looking at one point.

    It spans the part of space that the training cameras span, around their mean pose; the point lies straight ahead,
    where disparity is midway between that at near and at far. Intrinsics are those of the first training view.
    """
    poses = _training_poses(scene)
    center, up, back = poses[:, :, 3].mean(0), poses[:, :, 1].mean(0), poses[:, :, 2].mean(0)
    frame = pose(back, up, center)[:, :3]
    distance = 2.0 / (1.0 / max(scene.near, 1e-2 * scene.far) + 1.0 / scene.far)
    target = center - distance * frame[:, 2]
    # a lone camera spans nothing: sway by a few hundredths of the distance instead
    extent = ((poses[:, :, 3] - center) @ frame).abs().amax(0).clamp_min(0.03 * distance)
    extent[2] = extent[2].clamp_max(0.5 * distance)
    origins = []
    for i in range(frames):
        angle = 4 * math.pi * i / frames
        offset = torch.tensor(
            [math.cos(angle), math.sin(angle), math.sin(angle / 2)], dtype=poses.dtype
        )
        origins.append(center + frame @ (offset * extent))
    return _cameras(scene, [look_at(origin, target, up) for origin in origins])


def orbit_path(scene: Scene, frames: int) -> Cameras:
    """A closed circle around what the training cameras look at, starting at the side of the first one.

    It goes around the point nearest to all optical axes, about the direction that is upright in the photographs, with
    the mean radius and the mean height of the training cameras. Intrinsics are those of the first training view.
    """
    poses = _training_poses(scene)
    target, up = look_at_point(scene.cameras, scene.train, scene.box.mean(0)), upright(poses)
    offsets = poses[:, :, 3] - target
    heights = offsets @ up
    flat = offsets - heights[:, None] * up
    radius = torch.maximum(flat.norm(dim=-1).mean(), 0.1 * offsets.norm(dim=-1).mean())
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
    """The direction that points up in the photographs, unit length.

    Cameras that are not rolled have horizontal x axes, so it is orthogonal to all of them; where these do not differ
    enough to tell, it is the mean y axis.
    """
    right, mean_up = poses[:, :, 0], functional.normalize(poses[:, :, 1].mean(0), dim=0)
    eigenvalues, directions = torch.linalg.eigh(right.T @ right / len(poses))
    smallest, second = eigenvalues[0], eigenvalues[1]
    if second < 0.02 or smallest > 0.5 * second:
        return mean_up
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
