from __future__ import annotations

import pytest
import torch

from nerfreg.scenes import Procedural
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.lens import distort, invertible, undistort

LENS = (-0.28, 0.09, 1e-3, -8e-4, -0.01)


def camera(distortion: tuple[float, ...] = (0, 0, 0, 0, 0)) -> Cameras:
    """4 x 2 pixels at (1, 2, 3), looking along world +x with z up, so that right is world -y."""
    pose = torch.tensor([[[0.0, 0, -1, 1], [-1, 0, 0, 2], [0, 1, 0, 3]]])
    focal, center = torch.tensor([[2.0, 4.0]]), torch.tensor([[2.0, 1.0]])
    return Cameras(4, 2, pose, focal, center, torch.tensor([distortion], dtype=torch.float32))


def test_ray_by_hand():
    # Pixel (3, 0) has its centre at (3.5, 0.5): x = (3.5 - 2) / 2 = 0.75 and
    # y = (0.5 - 1) / 4 = -0.125 (down), so the ray is 1 ahead, 0.75 to the right, 0.125 up:
    # (1, -0.75, 0.125) in the world.
    origins, directions = camera().rays(torch.tensor([0]), torch.tensor([[3, 0]]))
    expected = torch.tensor([1, -0.75, 0.125]) / (1 + 0.75**2 + 0.125**2) ** 0.5
    torch.testing.assert_close(origins[0], torch.tensor([1.0, 2, 3]))
    torch.testing.assert_close(directions[0], expected)


def test_image_rays_run_row_by_row():
    cameras = camera()
    _, all_rays = cameras.image_rays(0)
    _, one = cameras.rays(torch.tensor([0]), torch.tensor([[1, 1]]))
    torch.testing.assert_close(all_rays[1 * 4 + 1], one[0])


def test_project_by_hand_and_behind():
    # (3, 1, 3.5) is 2 ahead, 1 to the right, 0.5 up: x = 2 + 2 * 1/2 = 3, y = 1 - 4 * 0.5/2 = 0.
    pixels = camera().project(torch.tensor([[3.0, 1, 3.5], [0.0, 2, 3]]), 0)
    torch.testing.assert_close(pixels[0], torch.tensor([3.0, 0.0]))
    assert pixels[1].isnan().all()


@pytest.mark.parametrize("distortion", [(0, 0, 0, 0, 0), LENS])
def test_projecting_a_ray_gives_its_pixel(distortion):
    cameras = camera(distortion)
    pixels = torch.tensor([[x, y] for x in range(4) for y in range(2)])
    origins, directions = cameras.rays(torch.zeros(8, dtype=torch.long), pixels)
    torch.testing.assert_close(
        cameras.project(origins + 5 * directions, 0), pixels + 0.5, atol=1e-4, rtol=0
    )


def test_distort_by_hand():
    # x = 1, y = 2: r2 = 5; radial = 1 + 0.1*5 + 0.01*25 + 0.001*125 = 1.875.
    # x' = 1.875 + 2*0.02*1*2 + 0.03*(5 + 2) = 2.165; y' = 3.75 + 0.02*(5 + 8) + 2*0.03*2 = 4.13.
    coefficients = torch.tensor([[0.1, 0.01, 0.02, 0.03, 0.001]])
    torch.testing.assert_close(
        distort(torch.tensor([[1.0, 2.0]]), coefficients), torch.tensor([[2.165, 4.13]])
    )


def test_undistort_inverts_a_wide_lens():
    side = torch.linspace(-0.8, 0.8, 9)
    points = torch.cartesian_prod(side, side)
    coefficients = torch.tensor(LENS).expand(len(points), 5)
    torch.testing.assert_close(
        undistort(distort(points, coefficients), coefficients), points, atol=1e-5, rtol=0
    )


def test_a_lens_that_folds_is_found():
    # k1 = -1: r' = r - r^3 is at most 0.385, at r = 0.577; nothing maps to 0.5.
    fold = torch.tensor([[-1.0, 0, 0, 0, 0]])
    assert invertible(torch.tensor([[0.3, 0.0]]), fold, 1e-4)
    assert not invertible(torch.tensor([[0.5, 0.0]]), fold, 1e-4)
    assert undistort(torch.tensor([[0.5, 0.0]]), fold).isfinite().all()


def test_some_of_the_views() -> None:
    scene = Procedural(size=16, views=3, test_views=2).load()
    some = scene.cameras.of([2, 0])
    assert len(some) == 2 and (some.width, some.height) == (16, 16)
    assert torch.equal(some.poses[1], scene.cameras.poses[0])
    point = scene.box.mean(0, keepdim=True)
    assert torch.equal(some.project(point, 0), scene.cameras.project(point, 2))


def test_photographs_are_those_of_the_training_views() -> None:
    scene = Procedural(size=16, views=3, test_views=2).load()
    photographs = scene.photographs()
    assert photographs.images.shape == (3, 16, 16, 4) and len(photographs.cameras) == 3
    for index, view in enumerate(scene.train):
        assert torch.equal(photographs.images[index], scene.read_image(view))
        assert torch.equal(photographs.cameras.poses[index], scene.cameras.poses[view])
    assert (photographs.near, photographs.far, photographs.layout) == (
        scene.near,
        scene.far,
        "object",
    )
