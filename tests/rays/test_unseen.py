"""Cameras between cameras."""

from __future__ import annotations

import math

import torch

from nerfreg.rays.unseen import poses_between


def camera_at(angle: float) -> torch.Tensor:
    """A pose on the circle of radius 2 around (1, 0, 0) at z = 0, looking at its centre, z up."""
    back = torch.tensor([math.cos(angle), math.sin(angle), 0.0])
    up = torch.tensor([0.0, 0.0, 1.0])
    return torch.stack(
        [torch.linalg.cross(up, back), up, back, 2 * back + torch.tensor([1.0, 0.0, 0.0])], dim=-1
    )


def test_halfway_on_an_orbit_is_on_the_orbit_and_looks_at_its_centre() -> None:
    pose = poses_between(
        camera_at(0.0)[None],
        camera_at(1.0)[None],
        torch.tensor([0.5]),
        torch.tensor([1.0, 0.0, 0.0]),
    )
    torch.testing.assert_close(pose[0], camera_at(0.5), rtol=0, atol=1e-6)


def test_the_ends_are_the_cameras_themselves() -> None:
    first, second = camera_at(0.2)[None], camera_at(0.9)[None]
    for center in (None, torch.tensor([1.0, 0.0, 0.0])):
        torch.testing.assert_close(poses_between(first, second, torch.tensor([0.0]), center), first)
        torch.testing.assert_close(
            poses_between(first, second, torch.tensor([1.0]), center), second
        )


def test_cameras_side_by_side_mix_position_and_axes() -> None:
    first, second = torch.eye(3, 4)[None], torch.eye(3, 4)[None].clone()
    second[0, 0, 3] = 4.0
    pose = poses_between(first, second, torch.tensor([0.25]))
    torch.testing.assert_close(pose[0, :, 3], torch.tensor([1.0, 0.0, 0.0]))
    torch.testing.assert_close(pose[0, :, :3], torch.eye(3))
