"""Two cameras side by side that look along -z, one unit apart."""

from __future__ import annotations

import math

import pytest
import torch
from nerfreg_plugins.stereo.views import PinholeViews, looked_up, pixel_indices, projected

from nerfreg import Photographs
from nerfreg.scenes.cameras import Cameras

WIDTH, HEIGHT, FOCAL, NEAR, FAR = 8, 6, 10.0, 1.0, 5.0


def views(images, factor=1):
    poses = torch.eye(3, 4).repeat(2, 1, 1)
    poses[1, 0, 3] = 1.0
    center = torch.tensor([WIDTH / 2, HEIGHT / 2]).expand(2, 2)
    cameras = Cameras(WIDTH, HEIGHT, poses, torch.full((2, 2), FOCAL), center, torch.zeros(2, 5))
    taken = Photographs(
        cameras=cameras,
        images=images,
        box=torch.tensor([[-FAR] * 3, [FAR] * 3]),
        near=NEAR,
        far=FAR,
        layout="forward",
    )
    return PinholeViews(taken, factor, sources=4)


@pytest.fixture
def pair():
    return views(torch.zeros(2, HEIGHT, WIDTH, 3))


def test_each_view_is_compared_with_the_others(pair):
    assert (len(pair), pair.sources) == (2, [[1], [0]])


@pytest.mark.parametrize("factor", [1, 2])
def test_a_point_moves_by_focal_length_over_depth(factor):
    reduced = views(torch.zeros(2, HEIGHT, WIDTH, 3), factor)
    at_infinity, epipole = reduced.projection(0, 1)
    height, width = HEIGHT // factor, WIDTH // factor
    middles = pixel_indices(height, width) + 0.5
    for depth in (2.0, 4.0):
        there = at_infinity + epipole / depth
        expected = middles - torch.tensor([FOCAL / factor / depth, 0.0])
        torch.testing.assert_close(projected(there), expected)
        # Side by side, the depth in the source is the same.
        torch.testing.assert_close(
            1 / depth / there[..., 2], torch.full((height, width), 1 / depth)
        )


def test_disparity_is_the_way_from_near_to_far(pair):
    # 10 pixels at depth 1, 2 at depth 5.
    assert pair.disparity(1 / NEAR, 1 / FAR) == pytest.approx(8)
    assert pair.disparity(1 / FAR, 1 / FAR) == 1  # at least


def test_only_what_a_source_agrees_with_is_consistent(pair):
    # At depth 2 everything moves by 5 pixels: columns 5 to 7 are seen by the source, as 0 to 2.
    inverse = torch.full((2, HEIGHT, WIDTH), 0.5)
    inverse[1, :, 1] = 0.6
    inverse[1, :, 2] = torch.nan
    agreed = pair.consistent(0, inverse, gap=0.05)
    assert (agreed[:, 5] == 0.5).all()
    assert agreed[:, :5].isnan().all() and agreed[:, 6:].isnan().all()


def test_colours_are_premultiplied_before_they_are_pooled():
    images = torch.zeros(2, HEIGHT, WIDTH, 4)
    images[..., :3] = 0.5
    images[:, ::2, ::2, 3] = 1.0  # one pixel of four is opaque
    images[:, :, 4:, 3] = 1.0
    reduced = views(images, factor=2)
    torch.testing.assert_close(reduced.images[0, 0, 0], torch.tensor([0.125] * 3 + [0.25]))
    torch.testing.assert_close(reduced.images[0, 0, 2], torch.tensor([0.5] * 3 + [1.0]))
    assert reduced.opaque[0, 0].tolist() == [False, False, True, True]


def test_nothing_is_seen_behind_a_camera_and_beside_an_image():
    points = torch.tensor([[2.0, 4.0, 2.0], [1.0, 1.0, 0.0], [1.0, 1.0, -1.0]])
    assert projected(points)[0].tolist() == [1.0, 2.0]
    assert projected(points)[1:].isnan().all()
    image = torch.arange(6.0).view(2, 3)
    places = torch.tensor([[0.5, 0.5], [2.9, 1.0], [3.0, 1.0], [-0.1, 0.0], [math.nan, 0.0]])
    held = looked_up(image, places)
    assert held[:2].tolist() == [0.0, 5.0]
    assert held[2:].isnan().all()
