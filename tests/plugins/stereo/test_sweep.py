"""Photographs of planes whose colour and distance are known."""

from __future__ import annotations

import torch
from nerfreg_plugins.stereo.sweep import plane_sweep

from nerfreg import Photographs
from nerfreg.scenes.cameras import Cameras

WIDTH, HEIGHT, FOCAL = 48, 36, 40.0
NEAR, FAR = 2.0, 12.0


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
    chance = torch.Generator().manual_seed(seed)
    waves = torch.randn(8, 3, 2, generator=chance) * 5
    phases = torch.rand(8, 3, generator=chance) * 6
    places = torch.stack([x, y], dim=-1)
    return 0.5 + 0.06 * torch.sin(torch.einsum("hwi,nci->hwnc", places, waves) + phases).sum(2)


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
    return Photographs(cameras, torch.stack(images), NEAR, FAR, layout)


def distances(photos, depth):
    """Of a plane at a depth, along the ray of each pixel."""
    rays = [photos.cameras.image_rays(view)[1] for view in range(len(photos.images))]
    return torch.stack([depth / -ray[:, 2] for ray in rays]).view(-1, HEIGHT, WIDTH)


def wall(depth):
    return lambda origins, directions: torch.full((len(origins),), depth)


def test_a_wall():
    photos = photographs(wall(5.0))
    known = plane_sweep(photos)
    assert known.shape == (3, HEIGHT, WIDTH, 2)
    found = known.isfinite().all(-1)
    truth = distances(photos, 5.0)
    inside = (known[..., 0] <= truth) & (truth <= known[..., 1])
    # The middle camera sees all but 0.6 * 40 / 5 = 4.8 pixels at either side in another photograph.
    assert found[1].float().mean() > 0.9
    assert inside[found].float().mean() > 0.99
    # A point at depth 5 moves by 0.6 * 40 / z pixels between neighbours, and twice that to the farthest source, so a
    # pixel either way is a depth of 25 / 48 either way.
    width = (known[..., 1] - known[..., 0])[found].median()
    assert 0.8 < width < 1.4


def test_two_walls():
    # The world left of x = 0.6 is at depth 4, right of it at 8: half of the middle picture each.
    def depth_of(origins, directions):
        close = (origins + 4 * directions)[:, 0] < 0.6
        return torch.where(close, 4.0, 8.0)

    photos = photographs(depth_of)
    known = plane_sweep(photos)[1]
    middle = known.mean(-1) * (4.0 / distances(photos, 4.0)[1])
    left, right = middle[:, 8:20], middle[:, 30:40]
    assert (left[left.isfinite()] - 4).abs().median() < 0.3
    assert (right[right.isfinite()] - 8).abs().median() < 0.8
    assert left.isfinite().float().mean() > 0.8 and right.isfinite().float().mean() > 0.7


def test_reduced_photographs_give_whole_maps():
    photos = photographs(wall(5.0))
    known = plane_sweep(photos, width=24)
    assert known.shape == (3, HEIGHT, WIDTH, 2)
    blocks = known.view(3, HEIGHT // 2, 2, WIDTH // 2, 2, 2)
    assert torch.equal(blocks[:, :, 0, :, 0].nan_to_num(), blocks[:, :, 1, :, 1].nan_to_num())
    found = known.isfinite().all(-1)
    truth = distances(photos, 5.0)
    # The corners of a block of 2 x 2 pixels are up to half a pixel away from the ray that was searched.
    assert ((known[..., 0] < truth * 1.02) & (truth < known[..., 1] * 1.02))[found].float().mean() > 0.95


def test_units_do_not_matter():
    photos = photographs(wall(5.0))
    poses = photos.cameras.poses.clone()
    poses[:, :, 3] *= 1024
    cameras = Cameras(WIDTH, HEIGHT, poses, photos.cameras.focal, photos.cameras.center, photos.cameras.distortion)
    larger = plane_sweep(Photographs(cameras, photos.images, NEAR * 1024, FAR * 1024, "forward"))
    torch.testing.assert_close(larger, plane_sweep(photos) * 1024, equal_nan=True)


def test_photographs_of_different_things_agree_on_little():
    photos = photographs(wall(5.0))
    others = torch.stack([photographs(wall(5.0), seed=seed).images[seed] for seed in range(3)])
    known = plane_sweep(Photographs(photos.cameras, others, NEAR, FAR, "forward"))
    assert known.isfinite().all(-1).float().mean() < 0.3


def test_without_texture_nothing_is_nearer_or_farther_than_the_scene():
    photos = photographs(wall(5.0))
    known = plane_sweep(Photographs(photos.cameras, torch.full_like(photos.images, 0.5), NEAR, FAR, "forward"))
    along = known.nan_to_num(5.0)
    assert (along > 0).all() and (along <= FAR * 1.5).all()


def test_nothing_is_known_where_there_is_no_object():
    photos = photographs(wall(5.0))
    alpha = torch.ones(3, HEIGHT, WIDTH, 1)
    alpha[:, :, : WIDTH // 2] = 0.2
    known = plane_sweep(Photographs(photos.cameras, torch.cat([photos.images, alpha], -1), NEAR, FAR, "orbit"))
    assert known[:, :, : WIDTH // 2].isnan().all()
    assert known[:, :, WIDTH // 2 + 4 :].isfinite().float().mean() > 0.5


def test_one_photograph_tells_nothing():
    photos = photographs(wall(5.0), count=1)
    assert plane_sweep(photos).isnan().all()


def test_rays_that_begin_at_the_camera():
    photos = photographs(wall(5.0))
    known = plane_sweep(Photographs(photos.cameras, photos.images, 0.0, FAR, "forward"))
    assert (known.nan_to_num(1.0) > 0).all() and known.isfinite().any()
