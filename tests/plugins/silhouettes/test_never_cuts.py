"""Whatever the photographs show is kept: every point of the solids, inside and on the surface."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch.nn.functional import pad

# Barrel, pincushion, tangential, and one that folds over outside of the photograph.
LENSES = {
    "barrel": (-0.25, 0.05, 0.0, 0.0, 0.0),
    "pincushion": (0.6, 0.3, 0.0, 0.0, 0.0),
    "tangential": (0.0, 0.0, 0.05, -0.04, 0.0),
    "all": (0.2, -0.1, -0.03, 0.02, 0.05),
    "folding": (0.3, -0.6, 0.0, 0.0, 0.0),
}


def kept(grid, points) -> bool:
    inside = ((points > -1) & (points < 1)).all(dim=1)
    return bool(grid.contains(points[inside]).all())


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("resolution", [24, 64])
def test_any_shape_from_anywhere(solids, cameras, photographs, points, hull, seed, resolution):
    grid = hull(photographs(solids, cameras(6, seed=seed)), resolution=resolution)
    assert kept(grid, points(solids, seed=seed))
    assert grid.occupied.float().mean() < 0.9


def test_cells_much_smaller_than_a_pixel(several, cameras, photographs, points, hull):
    grid = hull(photographs(several, cameras(5, seed=7)), resolution=192)
    assert kept(grid, points(several))


@pytest.mark.parametrize("lens", LENSES)
def test_lens_distortion(several, cameras, photographs, points, hull, lens):
    made = cameras(
        5,
        seed=3,
        distance=(2.2, 3.0),
        distortion=LENSES[lens],
        field_of_view=1.3,
    )
    assert kept(hull(photographs(several, made)), points(several))


def test_a_pixel_seen_by_its_centre_alone(cameras, photographs, points, hull, ball):
    # Every point of these lies in a disc of more than half the diagonal of a pixel, which no
    # centre of a pixel can miss: the margin of 1 makes up for what lies between the centres.
    several = [ball((0.3, 0.1, -0.2), 0.09), ball((-0.4, -0.1, 0.3), 0.3)]
    for seed in range(5):
        grid = hull(photographs(several, cameras(6, seed=seed, size=64), samples=1))
        assert kept(grid, points(several, seed=seed))


def test_borders_that_pass_between_pixels(cameras, photographs, points, hull, ball):
    # Radii that grow by a tenth of a pixel.
    for step in range(10):
        several = [ball((0.0, 0.0, 0.0), 0.3 + 0.01 * step)]
        grid = hull(photographs(several, cameras(4, seed=step, size=40)), margin=0.0)
        assert kept(grid, points(several, count=1000))


def test_cameras_inside_of_the_box(cameras, photographs, points, hull, ball):
    several = [ball((0.0, 0.0, 0.0), 0.15), ball((0.2, 0.2, 0.0), 0.08)]
    grid = hull(photographs(several, cameras(6, distance=(0.6, 1.0), field_of_view=1.4)))
    assert kept(grid, points(several))
    assert grid.occupied.float().mean() < 0.5


def test_one_view(several, cameras, photographs, points, hull):
    assert kept(hull(photographs(several, cameras(1))), points(several))


@pytest.mark.parametrize("target", [(0.9, 0.0, 0.0), (0.0, -0.9, 0.5)])
def test_silhouettes_that_touch_the_frame(several, cameras, photographs, points, hull, target):
    # Close, and turned aside: much of the solids lies outside of the images.
    made = cameras(4, target=target, distance=(1.3, 1.6), field_of_view=0.6)
    taken = photographs(several, made)
    grid = hull(taken)
    opaque = taken.images[..., 3] > 0
    if grid is None:
        assert not opaque.any()
        return
    assert kept(grid, points(several))


def test_a_piece_that_is_out_of_the_frame(cameras, photographs, points, hull, ball):
    # The first camera sees one ball, well inside of its image, and nothing of the other.
    several = [ball((-0.6, 0.0, 0.0), 0.12), ball((0.7, 0.3, 0.2), 0.2)]
    wide = cameras(5, seed=1, field_of_view=1.2)
    close = cameras(1, seed=2, target=(-0.6, 0.0, 0.0), field_of_view=0.35)
    both = {
        name: torch.cat([getattr(wide, name), getattr(close, name)])
        for name in ("poses", "focal", "center", "distortion")
    }
    taken = photographs(several, replace(wide, **both))
    assert 0 < (taken.images[-1, ..., 3] > 0).sum() < taken.images[-1, ..., 3].numel()
    grid = hull(taken)
    assert kept(grid, points(several))
    assert kept(hull(taken, frame=False), points(several))


def test_padding_is_no_part_of_a_photograph(several, cameras, photographs, points, hull):
    taken = photographs(several, cameras(6))
    valid = torch.ones_like(taken.images[..., 0], dtype=torch.bool)
    # The padding holds anything, and the second photograph has lost its right and lower part.
    images = pad(taken.images, (0, 0, 0, 13, 0, 9), value=1.0)
    valid = pad(valid, (0, 13, 0, 9))
    valid[1, 20:], valid[1, :, 24:] = False, False
    made = replace(taken, images=images, valid=valid)
    grid = hull(made)
    assert kept(grid, points(several))
    whole = replace(
        taken,
        images=pad(taken.images, (0, 0, 0, 13, 0, 9)),
        valid=pad(valid[2:3], (0, 0)).expand_as(valid),
    )
    assert torch.equal(hull(whole).occupied, hull(taken).occupied)


def test_masks_of_opaque_photographs(several, cameras, photographs, points, hull):
    taken = photographs(several, cameras(6))
    masked = replace(taken, images=taken.images[..., :3], masks=taken.images[..., 3] > 0.01)
    assert torch.equal(hull(masked).occupied, hull(taken).occupied)
    assert kept(hull(masked), points(several))


def test_soft_alpha(several, cameras, photographs, points, hull):
    taken = photographs(several, cameras(6))
    soft = taken.images.clone()
    # What is seen through, down to 2 %.
    soft[..., 3] *= 0.02 + 0.5 * torch.rand(soft.shape[:3], generator=torch.Generator())
    solid = taken.images[..., 3] == 1
    soft[..., 3] = torch.where(solid, soft[..., 3].clamp_min(0.011), taken.images[..., 3])
    assert kept(hull(replace(taken, images=soft)), points(several))


def test_a_view_that_sees_nothing(cameras, photographs, points, hull, ball):
    several = [ball((0.0, 0.0, 0.0), 0.3)]
    taken = photographs(several, cameras(6))
    poses = taken.cameras.poses.clone()
    # The last camera is turned round.
    poses[5, :, [0, 2]] *= -1
    away = photographs(several, replace(taken.cameras, poses=poses))
    assert not away.images[5, ..., 3].any()
    grid = hull(away)
    assert kept(grid, points(several))
    assert grid.occupied.sum() * grid.cell**3 < 1.0
