from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from nerfreg.errors import NerfregError
from nerfreg.scenes import bounds
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.poses import look_at, recenter

UP = torch.tensor([0.0, 0.0, 1.0])


def cameras_at(
    positions: list[tuple[float, float, float]], target: tuple[float, float, float]
) -> Cameras:
    """20 x 10 pixels, focal length 10: half fields of view 45 degrees and atan(1/2)."""
    poses = look_at(torch.tensor(positions).float(), torch.tensor(target).float(), UP)
    count = len(positions)
    return Cameras(
        20,
        10,
        poses,
        torch.full((count, 2), 10.0),
        torch.tensor([10.0, 5.0]).expand(count, 2),
        torch.zeros(count, 5),
    )


def raised() -> torch.Tensor:
    """What moves a pose up by one."""
    return torch.tensor([[0.0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]])


def test_look_at_point_is_where_axes_meet():
    cameras = cameras_at([(5, 0, 0), (0, 7, 1), (3, 3, 3)], (1, 2, 3))
    torch.testing.assert_close(bounds.look_at_point(cameras, (0, 1, 2)), torch.tensor([1.0, 2, 3]))


def test_look_at_point_of_one_view_is_nearest_to_the_origin():
    # The axis runs along y through (1, *, 2); the point on it nearest to the origin is (1, 0, 2).
    cameras = cameras_at([(1, -5, 2)], (1, 5, 2))
    torch.testing.assert_close(
        bounds.look_at_point(cameras, (0,)), torch.tensor([1.0, 0, 2]), atol=1e-5, rtol=0
    )


def test_look_at_point_of_skew_axes_lies_between_them():
    # along x at height 0 and along y at height 1: the point nearest to both is half way up
    cameras = cameras_at([(5, 0, 0), (0, 5, 0)], (0, 0, 0))
    both = replace(
        cameras, poses=cameras.poses + torch.tensor([0.0, 1.0])[:, None, None] * raised()
    )
    torch.testing.assert_close(
        bounds.look_at_point(both, (0, 1)), torch.tensor([0.0, 0, 0.5]), atol=1e-5, rtol=0
    )


def test_look_at_point_of_one_view_is_beside_the_prior():
    cameras = cameras_at([(5, 0, 0)], (0, 0, 0))
    found = bounds.look_at_point(cameras, (0,), torch.tensor([2.0, 7.0, 1.0]))
    torch.testing.assert_close(found, torch.tensor([2.0, 0, 0]), atol=1e-5, rtol=0)


def test_orbit_box_and_its_bounds():
    # Nearest camera at distance 4, narrowest half field atan(1/2):
    # radius 4 sin(atan(1/2)) = 4 / sqrt(5).
    cameras = cameras_at([(5, 2, 3), (1, 8, 3), (101, 2, 3)], (1, 2, 3))
    radius = 4 / math.sqrt(5)
    box = bounds.orbit_box(cameras, (0, 1), 1.0)
    torch.testing.assert_close(
        box, torch.tensor([[1.0, 2, 3], [1.0, 2, 3]]) + torch.tensor([[-radius], [radius]])
    )
    near, far = bounds.bounds_of_box(cameras, (0, 1, 2), box)
    assert near == pytest.approx(4 - radius * math.sqrt(3))
    assert far == pytest.approx(100 + radius * math.sqrt(3))
    room = bounds.orbit_box(cameras, (0, 1), bounds.ROOM_EXTENT)
    assert float(room[1, 0] - room[0, 0]) == pytest.approx(2 * radius * 4)
    # That box contains the cameras: rays then begin a twentieth of the way.
    assert bounds.bounds_of_box(cameras, (0, 1), room)[0] == pytest.approx(0.05 * 4)


def test_cameras_that_look_away_are_refused():
    cameras = cameras_at([(5, 0, 0), (0, 5, 0)], (0, 0, 0))
    away = replace(cameras, poses=cameras.poses * torch.tensor([-1, 1, -1, 1.0]))
    with pytest.raises(NerfregError, match="do not look at one place"):
        bounds.orbit_box(away, (0, 1), 1.0)


def test_frusta_box_and_ray_length():
    # Looking along +y from (0, -3, 0): at depth d the image spans x = +-d, z = +-d/2.
    cameras = cameras_at([(0, -3, 0), (2, -3, 0)], (0, 10, 0))
    box = bounds.frusta_box(cameras, (0,), 1.0, 4.0)
    torch.testing.assert_close(box, torch.tensor([[-4.0, -2, -2], [4.0, 1, 2]]))
    assert bounds.ray_length(cameras, (0,), 4.0) == pytest.approx(
        4 * math.sqrt(1 + 1 + 0.25), rel=1e-5
    )


def test_layout():
    assert (
        bounds.find_layout(cameras_at([(-1, -5, 0), (1, -5, 0), (0, -5, 1)], (0, 0, 0)), (0, 1, 2))
        == "forward"
    )
    assert (
        bounds.find_layout(cameras_at([(5, 0, 1), (0, 5, 1), (-5, 0, 1)], (0, 0, 0)), (0, 1, 2))
        == "orbit"
    )


def test_recentering_is_rigid_and_makes_the_average_the_identity():
    poses = cameras_at([(4, -1, 2), (6, -1, 2), (5, 1, 2)], (5, 0, 40)).poses.double()
    moved = recenter(poses).numpy()
    poses = poses.numpy()
    np.testing.assert_allclose(moved[:, :, 3].mean(0), 0, atol=1e-6)
    np.testing.assert_allclose(np.cross(moved[:, :, 2].sum(0), [0, 0, 1]), 0, atol=1e-6)
    distances = [np.linalg.norm(p[0, :, 3] - p[1, :, 3]) for p in (poses, moved)]
    assert distances[0] == pytest.approx(distances[1])
    np.testing.assert_allclose(
        poses[0, :, :3].T @ poses[1, :, :3], moved[0, :, :3].T @ moved[1, :, :3], atol=1e-6
    )
