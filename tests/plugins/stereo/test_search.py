"""Photographs of planes whose colour and distance are known."""

from __future__ import annotations

import dataclasses

import torch
from nerfreg_plugins.stereo.search import agreed_depth

from nerfreg import Photographs
from nerfreg.scenes.cameras import Cameras

WIDTH, HEIGHT, FOCAL = 48, 36, 40.0
NEAR, FAR = 2.0, 12.0
BOX = torch.tensor([[-FAR] * 3, [FAR] * 3])


def side_by_side(count, baseline=0.6):
    """Cameras in a row that look along -z."""
    poses = torch.eye(3, 4).repeat(count, 1, 1)
    poses[:, 0, 3] = baseline * torch.arange(count)
    return Cameras(
        WIDTH,
        HEIGHT,
        poses,
        torch.full((count, 2), FOCAL),
        torch.tensor([WIDTH / 2, HEIGHT / 2]).expand(count, 2),
        torch.zeros(count, 5),
    )


def texture(x, y, seed):
    """A colour for each place of a plane: waves of a few pixels' length in all directions."""
    generator = torch.Generator().manual_seed(seed)
    waves = torch.randn(8, 3, 2, generator=generator) * 5
    phases = torch.rand(8, 3, generator=generator) * 6
    places = torch.stack([x, y], dim=-1)
    return 0.5 + 0.06 * torch.sin(torch.einsum("hwi,nci->hwnc", places, waves) + phases).sum(2)


def taken_by(cameras, images, near, far, layout):
    """These images as the photographs of a scene."""
    return Photographs(cameras=cameras, images=images, box=BOX, near=near, far=far, layout=layout)


def photographs(depth_of, count=3, seed=0, layout="forward"):
    """Every pixel shows the texture at depth_of(x of the world) along the optical axis."""
    cameras = side_by_side(count)
    images = []
    for view in range(count):
        origins, directions = cameras.image_rays(view)
        directions = directions / -directions[:, 2:]
        depth = depth_of(origins, directions)
        points = (origins + directions * depth[:, None]).view(HEIGHT, WIDTH, 3)
        images.append(texture(points[..., 0], points[..., 1], seed))
    return taken_by(cameras, torch.stack(images), NEAR, FAR, layout)


def distances(photos, depth):
    """Of a plane at a depth, along the ray of each pixel."""
    rays = [photos.cameras.image_rays(view)[1] for view in range(len(photos.images))]
    return torch.stack([depth / -ray[:, 2] for ray in rays]).view(-1, HEIGHT, WIDTH)


def wall(depth):
    return lambda origins, directions: torch.full((len(origins),), depth)


def correctness(photos, depth, **options):
    """How much is known of the middle photograph's pixels, and how often it is right."""
    known = agreed_depth(photos, **options)[1]
    found = known.isfinite().all(-1)
    truth = distances(photos, depth)[1]
    return found.float().mean(), ((known[..., 0] <= truth) & (truth <= known[..., 1]))[
        found
    ].float().mean()


def test_a_wall():
    photos = photographs(wall(5.0))
    known = agreed_depth(photos)
    assert known.shape == (3, HEIGHT, WIDTH, 2)
    found = known.isfinite().all(-1)
    truth = distances(photos, 5.0)
    inside = (known[..., 0] <= truth) & (truth <= known[..., 1])
    # The middle camera sees all but 0.6 * 40 / 5 = 4.8 pixels at either side in another photograph.
    assert found[1].float().mean() > 0.9
    assert inside[found].float().mean() > 0.99
    # A point at depth 5 moves by 0.6 * 40 / z pixels between neighbours, and twice that to the
    # farthest source, so a pixel either way is a depth of 25 / 48 either way.
    width = (known[..., 1] - known[..., 0])[found].median()
    assert 0.8 < width < 1.4


def test_two_walls():
    # The world left of x = 0.6 is at depth 4, right of it at 8: half of the middle picture each.
    def depth_of(origins, directions):
        close = (origins + 4 * directions)[:, 0] < 0.6
        return torch.where(close, 4.0, 8.0)

    photos = photographs(depth_of)
    known = agreed_depth(photos)[1]
    middle = known.mean(-1) * (4.0 / distances(photos, 4.0)[1])
    left, right = middle[:, 8:20], middle[:, 30:40]
    assert (left[left.isfinite()] - 4).abs().median() < 0.3
    assert (right[right.isfinite()] - 8).abs().median() < 0.8
    assert left.isfinite().float().mean() > 0.8 and right.isfinite().float().mean() > 0.7


def test_reduced_photographs_give_whole_maps():
    photos = photographs(wall(5.0))
    known = agreed_depth(photos, width=24)
    assert known.shape == (3, HEIGHT, WIDTH, 2)
    truth = distances(photos, 5.0)
    along_axis = known / truth[..., None]
    blocks = along_axis.view(3, HEIGHT // 2, 2, WIDTH // 2, 2, 2)
    torch.testing.assert_close(blocks[:, :, 0, :, 0], blocks[:, :, 1, :, 1], equal_nan=True)
    found = known.isfinite().all(-1)
    assert found[1].float().mean() > 0.8
    assert ((along_axis[..., 0] < 1) & (along_axis[..., 1] > 1))[found].float().mean() > 0.95


def test_a_floor_at_a_grazing_angle():
    # Depth along the axis where the ray meets y = -1.5; the middle of the picture is bounded by a
    # wall.
    def depth_of(origins, directions):
        return torch.minimum(-1.5 / directions[:, 1].clamp_max(-1e-6), torch.tensor(11.0))

    photos = photographs(depth_of)
    known = agreed_depth(photos)[1]
    origins, directions = photos.cameras.image_rays(1)
    along = -directions[:, 2]
    truth = (depth_of(origins, directions / along[:, None]) / along).view(HEIGHT, WIDTH)
    floor = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    floor[-8:-1, 6:-6] = True
    found = known.isfinite().all(-1) & floor
    assert found.sum() > 0.8 * floor.sum()
    assert ((known[..., 0] <= truth) & (truth <= known[..., 1]))[found].float().mean() > 0.9


def test_more_tolerance_believes_more_and_less_exactly():
    photos = photographs(wall(5.0))
    strict, loose = (agreed_depth(photos, tolerance=tolerance) for tolerance in (0.2, 2.0))
    assert strict.isfinite().sum() < loose.isfinite().sum()
    assert (strict[..., 1] - strict[..., 0]).nanmedian() < 0.2 * (
        loose[..., 1] - loose[..., 0]
    ).nanmedian()


def test_a_lens_that_bends():
    photos = photographs(wall(5.0))
    bent = dataclasses.replace(
        photos.cameras, distortion=torch.tensor([-0.3, 0.05, 0.01, 0.0, 0.0]).expand(3, 5)
    )
    images = []
    for view in range(3):
        origins, directions = bent.image_rays(view)
        points = (origins + 5 * directions / -directions[:, 2:]).view(HEIGHT, WIDTH, 3)
        images.append(texture(points[..., 0], points[..., 1], 0))
    bent_photos = dataclasses.replace(photos, cameras=bent, images=torch.stack(images))
    found, right = correctness(bent_photos, 5.0)
    assert found > 0.8 and right > 0.97
    # Without its distortion the same photographs are of something else.
    wrong = dataclasses.replace(bent_photos, cameras=photos.cameras)
    assert (
        correctness(wrong, 5.0, tolerance=0.3)[1]
        < correctness(bent_photos, 5.0, tolerance=0.3)[1] - 0.1
    )


def test_units_do_not_matter():
    photos = photographs(wall(5.0))
    poses = photos.cameras.poses.clone()
    poses[:, :, 3] *= 1024
    cameras = Cameras(
        WIDTH, HEIGHT, poses, photos.cameras.focal, photos.cameras.center, photos.cameras.distortion
    )
    larger = agreed_depth(taken_by(cameras, photos.images, NEAR * 1024, FAR * 1024, "forward"))
    torch.testing.assert_close(larger, agreed_depth(photos) * 1024, equal_nan=True)


def test_photographs_of_different_things_agree_on_little():
    photos = photographs(wall(5.0))
    others = torch.stack([photographs(wall(5.0), seed=seed).images[seed] for seed in range(3)])
    known = agreed_depth(taken_by(photos.cameras, others, NEAR, FAR, "forward"))
    assert known.isfinite().all(-1).float().mean() < 0.3


def test_without_texture_nothing_is_nearer_or_farther_than_the_scene():
    photos = photographs(wall(5.0))
    known = agreed_depth(
        taken_by(photos.cameras, torch.full_like(photos.images, 0.5), NEAR, FAR, "forward")
    )
    along = known.nan_to_num(5.0)
    assert (along > 0).all() and (along <= FAR * 1.5).all()


def test_nothing_is_known_where_there_is_no_object():
    photos = photographs(wall(5.0))
    alpha = torch.ones(3, HEIGHT, WIDTH, 1)
    alpha[:, :, : WIDTH // 2] = 0.2
    known = agreed_depth(
        taken_by(photos.cameras, torch.cat([photos.images, alpha], -1), NEAR, FAR, "object")
    )
    assert known[:, :, : WIDTH // 2].isnan().all()
    assert known[:, :, WIDTH // 2 + 4 :].isfinite().float().mean() > 0.5


def test_one_photograph_tells_nothing():
    photos = photographs(wall(5.0), count=1)
    assert agreed_depth(photos).isnan().all()


def test_rays_that_begin_at_the_camera():
    photos = photographs(wall(5.0))
    known = agreed_depth(taken_by(photos.cameras, photos.images, 0.0, FAR, "forward"))
    assert (known.nan_to_num(1.0) > 0).all() and known.isfinite().any()
