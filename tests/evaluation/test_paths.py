from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from torch import Tensor

from nerfreg.evaluation.paths import orbit_path, spiral_path, upright
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.poses import look_at

UP = torch.tensor([0.0, 0.0, 1.0])
TARGET = torch.tensor([1.0, 2.0, 3.0])


def project(cameras: Cameras, point: Tensor) -> tuple[Tensor, Tensor]:
    """Pixels (x, y) of a point in every camera, (V, 2), and its depths along -z."""
    local = torch.einsum("vij,vi->vj", cameras.poses[:, :, :3], point - cameras.poses[:, :, 3])
    depth = -local[:, 2]
    x = cameras.center[:, 0] + cameras.focal[:, 0] * local[:, 0] / depth
    y = cameras.center[:, 1] - cameras.focal[:, 1] * local[:, 1] / depth
    return torch.stack([x, y], dim=-1), depth


def ring(azimuths: list[float], elevation: float = math.pi / 6, radius: float = 4.0) -> Tensor:
    poses = []
    for azimuth in azimuths:
        flat = math.cos(elevation)
        out = torch.tensor(
            [flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)]
        )
        poses.append(look_at(TARGET + radius * out, TARGET, UP))
    return torch.stack(poses)


def assert_rigid(poses: Tensor) -> None:
    rotation = poses[:, :, :3]
    assert torch.allclose(rotation.mT @ rotation, torch.eye(3).expand_as(rotation), atol=1e-5)
    assert torch.allclose(torch.linalg.det(rotation), torch.ones(len(poses)), atol=1e-5)


def test_look_at_sees_the_target_ahead_and_up_above():
    # from +x looking at the origin, z up: right is +y, up is +z, back is +x
    pose = look_at(torch.tensor([5.0, 0.0, 0.0]), torch.zeros(3), UP)
    assert pose.T.tolist() == [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]]


def test_orbit_keeps_the_training_cameras_circle_and_looks_at_its_middle(make_scene):
    scene = make_scene(poses=ring([0.3, 1.4, 2.0, 4.5]))
    path = orbit_path(scene, 12)
    pixel, depth = project(path, TARGET)
    # 4 sin 30 = 2 above the target, 4 cos 30 = 3.4641 beside it, 4 away
    assert torch.allclose(pixel, torch.tensor([[6.0, 4.0]]).expand(12, 2), atol=1e-3)
    assert torch.allclose(depth, torch.full((12,), 4.0), atol=1e-3)
    assert torch.allclose(path.poses[:, 2, 3], torch.full((12,), 5.0), atol=1e-3)
    assert_rigid(path.poses)


def test_orbit_starts_at_the_first_training_camera_and_is_even_and_closed(make_scene):
    scene = make_scene(poses=ring([0.3, 1.4, 2.0, 4.5]))
    path = orbit_path(scene, 8)
    assert torch.allclose(path.poses[0], scene.cameras.poses[0], atol=1e-3)
    origins = path.poses[:, :, 3]
    steps = (origins - origins.roll(1, dims=0)).norm(dim=-1)
    # chord of an eighth of a circle of radius 3.4641: 2 r sin(pi / 8)
    assert torch.allclose(steps, torch.full((8,), 2 * 3.4641016 * math.sin(math.pi / 8)), atol=1e-3)


def test_orbit_is_upright(make_scene):
    path = orbit_path(make_scene(poses=ring([0.3, 1.4, 2.0])), 6)
    above, _ = project(path, TARGET + 0.2 * UP)
    assert torch.allclose(above[:, 0], torch.full((6,), 6.0), atol=1e-3)
    assert (above[:, 1] < 3.9).all()  # image rows run down


def test_upright_is_exact_for_cameras_on_one_side_only():
    # the mean y axis of these tilts by about 30 degrees towards them
    up = upright(ring([0.0, 0.5, 0.9]))
    assert torch.allclose(up, UP, atol=1e-4)


def test_upright_of_one_camera_is_its_own_y_axis():
    poses = ring([0.7])
    assert torch.allclose(upright(poses), poses[0, :, 1], atol=1e-5)


def forward_facing() -> Tensor:
    """Cameras side by side on z = 0, looking along -z."""
    poses = torch.eye(3, 4).repeat(4, 1, 1)
    poses[:, :2, 3] = torch.tensor([[-0.4, -0.1], [0.4, -0.1], [-0.4, 0.1], [0.4, 0.1]])
    return poses


def test_spiral_looks_at_the_middle_of_disparity_and_stays_where_cameras_were(make_scene):
    scene = make_scene(poses=forward_facing(), layout="forward", near=1.0, far=3.0)
    path = spiral_path(scene, 16)
    # disparities 1 and 1/3, their mean 2/3: a distance of 1.5 straight ahead
    pixel, depth = project(path, torch.tensor([0.0, 0.0, -1.5]))
    assert torch.allclose(pixel, torch.tensor([[6.0, 4.0]]).expand(16, 2), atol=1e-4)
    assert (depth > 0).all()
    extent = path.poses[:, :, 3].abs().amax(0)
    # the smallest sway is 0.03 * 1.5 = 0.045, taken along z where the cameras span nothing
    assert torch.allclose(extent, torch.tensor([0.4, 0.1, 0.045]), atol=1e-4)
    assert_rigid(path.poses)


def test_spiral_is_closed_and_near_may_be_0(make_scene):
    path = spiral_path(make_scene(poses=forward_facing(), layout="forward", near=0.0), 60)
    origins = path.poses[:, :, 3]
    steps = (origins - origins.roll(1, dims=0)).norm(dim=-1)
    assert steps.max() < 0.1
    assert_rigid(path.poses)


@pytest.mark.parametrize("build", [orbit_path, spiral_path])
def test_only_training_cameras_count_and_intrinsics_are_the_first_ones(make_scene, build):
    poses = torch.cat([ring([0.3, 1.4, 2.0]), 100 * torch.randn(1, 3, 4)])
    scene = make_scene(poses=poses)
    scene.cameras.focal[1] = torch.tensor([7.0, 8.0])
    chosen = dataclasses.replace(scene, train=(1, 2, 0))
    alone = make_scene(poses=poses[[1, 2, 0]])
    path = build(chosen, 4)
    assert torch.allclose(path.poses, build(alone, 4).poses, atol=1e-5)
    assert torch.equal(path.focal, torch.tensor([[7.0, 8.0]]).expand(4, 2))
    assert (path.width, path.height, len(path)) == (12, 8, 4)


@pytest.mark.parametrize("build", [orbit_path, spiral_path])
def test_a_single_training_camera_still_moves(make_scene, build):
    path = build(make_scene(poses=ring([0.7])), 5)
    assert_rigid(path.poses)
    assert path.poses.isfinite().all()
    assert (path.poses[1:, :, 3] - path.poses[0, :, 3]).norm(dim=-1).min() > 0.01
