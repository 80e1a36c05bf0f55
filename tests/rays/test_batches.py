"""What is in a batch, for every kind of need."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from nerfreg.errors import NerfregError
from nerfreg.hooks import Needs, OccupancyGrid, Rays
from nerfreg.rays import RayBatches
from nerfreg.scenes import Procedural, Scene


@pytest.fixture(scope="module")
def orbit() -> Scene:
    return Procedural(size=32, views=3, test_views=1).load()


@pytest.fixture(scope="module")
def forward() -> Scene:
    return Procedural(size=32, views=3, test_views=1, layout="forward").load()


def draw(scene: Scene, needs: Needs, count: int = 64) -> Rays:
    batches = RayBatches(scene, count, torch.device("cpu"), torch.Generator().manual_seed(0))
    return batches.draw(needs)


def pixels_of(scene: Scene, rays: Rays) -> tuple[torch.Tensor, torch.Tensor]:
    """View and pixel of each ray, by projecting one of its points into the view it starts from."""
    distances = (rays.origins[:, None] - scene.cameras.poses[list(scene.train), :, 3]).norm(dim=-1)
    views = torch.tensor(scene.train)[distances.argmin(dim=1)]
    points = rays.origins + rays.directions
    pixels = torch.stack(
        [scene.cameras.project(p[None], int(v))[0] for p, v in zip(points, views, strict=True)]
    )
    return views, pixels


def test_needing_nothing_renders_nothing_more(orbit: Scene) -> None:
    rays = draw(orbit, Needs())
    assert len(rays) == len(rays.targets) == 64
    assert rays.patches is rays.neighbors is rays.unseen is rays.groups is None
    assert (rays.far > rays.near).all()


def test_targets_are_the_pixels_of_the_photographs(forward: Scene) -> None:
    rays = draw(forward, Needs(patch_size=4, patch_fraction=0.5))
    assert rays.background is None
    views, pixels = pixels_of(forward, rays)
    for target, view, pixel in zip(
        rays.targets, views.tolist(), pixels.floor().long().tolist(), strict=True
    ):
        assert torch.equal(target, forward.read_image(view)[pixel[1], pixel[0]])


def test_known_depth_belongs_to_the_pixel(forward: Scene) -> None:
    # A map that says where it is: view, and row and column.
    batches = RayBatches(forward, 64, torch.device("cpu"), torch.Generator().manual_seed(0))
    assert batches.draw(Needs()).known_depth is None
    view, row, column = torch.meshgrid(
        torch.arange(3.0), torch.arange(32.0), torch.arange(32.0), indexing="ij"
    )
    batches.known_depth = torch.stack([100 * view + row, column], dim=-1)
    rays = batches.draw(
        Needs(patch_size=4, patch_fraction=0.5, neighbors="extra", unseen_rays=0.25)
    )
    assert rays.known_depth is not None and rays.known_depth.shape == (48, 2)
    views, pixels = pixels_of(forward, rays)
    position = torch.tensor([forward.train.index(int(view)) for view in views])
    for known, place, pixel in zip(rays.known_depth, position, pixels.floor(), strict=False):
        assert known.tolist() == [100 * place + pixel[1], pixel[0]]


def test_alpha_is_put_on_the_background_of_the_ray(orbit: Scene) -> None:
    rays = draw(orbit, Needs())
    assert rays.background is not None
    views, pixels = pixels_of(orbit, rays)
    for i, (view, pixel) in enumerate(
        zip(views.tolist(), pixels.floor().long().tolist(), strict=True)
    ):
        value = orbit.read_image(view)[pixel[1], pixel[0]]
        expected = value[:3] * value[3] + rays.background[i] * (1 - value[3])
        torch.testing.assert_close(rays.targets[i], expected)
    assert rays.background.std() > 0.2


def test_patches_are_squares_of_adjacent_pixels_of_one_view(orbit: Scene) -> None:
    rays = draw(orbit, Needs(patch_size=4, patch_fraction=0.5))
    assert rays.patches is not None and rays.patches.shape == (2, 4, 4) and len(rays) == 64
    views, pixels = pixels_of(orbit, rays)
    for patch in rays.patches:
        assert len(views[patch.flatten()].unique()) == 1
        offsets = pixels[patch] - pixels[patch[0, 0]]
        y, x = torch.meshgrid(torch.arange(4.0), torch.arange(4.0), indexing="ij")
        torch.testing.assert_close(offsets, torch.stack([x, y], dim=-1), rtol=0, atol=1e-2)


@pytest.mark.parametrize(
    "needs",
    [
        Needs(patch_size=4, patch_fraction=0.5, neighbors="patch"),
        Needs(patch_fraction=0.25, neighbors="patch"),
        Needs(neighbors="extra"),
        Needs(patch_size=4, patch_fraction=0.5, neighbors="extra"),
    ],
)
def test_neighbours_are_adjacent_and_share_their_group(orbit: Scene, needs: Needs) -> None:
    rays = draw(orbit, needs)
    assert rays.neighbors is not None and rays.groups is not None
    _, pixels = pixels_of(orbit, rays)
    first, second = rays.neighbors.unbind(dim=1)
    torch.testing.assert_close(
        (pixels[first] - pixels[second]).norm(dim=-1), torch.ones(len(first)), atol=1e-2, rtol=0
    )
    assert torch.equal(rays.groups[first], rays.groups[second])
    # groups are numbered without gaps, and a patch is one group
    assert torch.equal(rays.groups.unique(), torch.arange(int(rays.groups.max()) + 1))
    if rays.patches is not None:
        assert (rays.groups[rays.patches].flatten(1).float().std(dim=1, correction=0) == 0).all()


def test_a_patch_counts_as_much_as_one_random_pixel(orbit: Scene) -> None:
    rays = draw(orbit, Needs(patch_size=4, patch_fraction=0.5))
    # 32 pixels and 2 patches of 16: 34 equal shares of a mean of 1 over 64 rays,
    # hence 64/34 and 64/34/16
    expected = torch.cat([torch.full((32,), 64 / 34), torch.full((32,), 64 / 34 / 16)])
    assert rays.target_weights is not None
    torch.testing.assert_close(rays.target_weights, expected)
    whole = draw(orbit, Needs(patch_size=4, patch_fraction=1.0)).target_weights
    assert whole is not None
    torch.testing.assert_close(whole, torch.ones(64))
    assert draw(orbit, Needs()).target_weights is None


def test_neighbours_in_patches_cost_no_ray_and_extra_ones_do(orbit: Scene) -> None:
    assert len(draw(orbit, Needs(patch_size=4, patch_fraction=0.5, neighbors="patch"))) == 64
    extra = draw(orbit, Needs(patch_size=4, patch_fraction=0.5, neighbors="extra"))
    assert len(extra) == 64 + 32 and len(extra.targets) == 64


@pytest.mark.parametrize("layout", ["orbit", "forward"])
def test_unseen_rays_start_between_the_cameras(layout: str, request: pytest.FixtureRequest) -> None:
    scene = request.getfixturevalue(layout)
    rays = draw(scene, Needs(unseen_rays=0.5))
    assert rays.unseen is not None
    assert torch.equal(rays.unseen, torch.arange(32, 64)) and len(rays.targets) == 32
    positions = scene.cameras.poses[list(scene.train), :, 3]
    start = rays.origins[rays.unseen]
    assert (start[:, None] - positions).norm(dim=-1).min() > 0
    if layout == "orbit":
        center = scene.box.mean(dim=0)
        radii = (positions - center).norm(dim=-1)
        distance = (start - center).norm(dim=-1)
        assert (distance > radii.min() - 1e-3).all() and (distance < radii.max() + 1e-3).all()
    else:
        assert (start >= positions.amin(dim=0) - 1e-4).all() and (
            start <= positions.amax(dim=0) + 1e-4
        ).all()


def test_the_same_seed_draws_the_same_batch(orbit: Scene) -> None:
    needs = Needs(patch_size=4, patch_fraction=0.5, neighbors="patch", unseen_rays=0.1)
    first, second = draw(orbit, needs), draw(orbit, needs)
    assert torch.equal(first.origins, second.origins) and torch.equal(first.targets, second.targets)


def test_a_box_that_no_ray_meets_is_refused(orbit: Scene) -> None:
    away = dataclasses.replace(orbit, box=orbit.box + 1000.0)
    with pytest.raises(NerfregError, match=r"no ray of a training view meets scene.box"):
        RayBatches(away, 8, torch.device("cpu"), torch.Generator())


def test_patches_larger_than_the_images_are_refused(orbit: Scene) -> None:
    with pytest.raises(NerfregError, match=r"patch_size 33 is larger than the images"):
        draw(orbit, Needs(patch_size=33, patch_fraction=1.0), 2000)


@pytest.mark.parametrize("layout", ["orbit", "forward"])
def test_unseen_patches_are_squares_of_one_unseen_camera_each(
    layout: str, request: pytest.FixtureRequest
) -> None:
    scene = request.getfixturevalue(layout)
    rays = draw(scene, Needs(patch_size=4, unseen_patches=0.5, unseen_rays=0.25))
    assert rays.unseen is not None and rays.unseen_patches is not None
    # Half of 64 rays are two patches; a quarter would be fewer, and is contained. No training patch
    # was asked for.
    assert rays.unseen_patches.shape == (2, 4, 4) and rays.patches is None
    assert torch.equal(rays.unseen_patches.flatten(), rays.unseen) and len(rays.targets) == 32
    for patch in rays.unseen_patches:
        assert (rays.origins[patch] == rays.origins[patch[0, 0]]).all()
        directions = rays.directions[patch]
        across = (directions[:, 1:] - directions[:, :-1]).norm(dim=-1)
        down = (directions[1:] - directions[:-1]).norm(dim=-1)
        torch.testing.assert_close(across, across.mean().expand_as(across), rtol=0.2, atol=0)
        torch.testing.assert_close(down, down.mean().expand_as(down), rtol=0.2, atol=0)
    more = draw(scene, Needs(patch_size=4, unseen_patches=0.25, unseen_rays=0.5))
    assert len(more.unseen) == 32 and more.unseen_patches.shape == (1, 4, 4)
    assert torch.equal(more.unseen_patches.flatten(), more.unseen[:16])


def grid_of(scene: Scene, part) -> OccupancyGrid:
    """The cells of 32^3 over the box whose centres lie in a part of space."""
    everywhere = torch.ones((32,) * 3, dtype=torch.bool)
    grid = OccupancyGrid.over(scene.info.center, scene.info.half_box, everywhere)
    return OccupancyGrid(part(grid.centers), grid.low, grid.cell)


def test_pixels_that_meet_no_occupied_cell_are_not_drawn(orbit: Scene) -> None:
    batches = RayBatches(orbit, 64, torch.device("cpu"), torch.Generator().manual_seed(0))
    before = batches.pixels
    grid = grid_of(orbit, lambda at: (at - orbit.info.center).norm(dim=-1) < 0.3)
    batches.keep_what_meets(grid)
    # Against the cells at many points of every ray.
    met = []
    for image, x, y in before.tolist():
        origin, ahead = orbit.cameras.rays(
            torch.tensor([orbit.train[image]]), torch.tensor([[x, y]])
        )
        near, far = orbit.info.clipped(origin, ahead)
        t = torch.lerp(near, far, torch.linspace(0, 1, 4000))[:, None]
        met.append(bool(grid.contains(origin + ahead * t).any()))
    sampled, kept = torch.tensor(met), batches.pixels
    lost = {tuple(row) for row in before[sampled].tolist()} - {tuple(row) for row in kept.tolist()}
    more = {tuple(row) for row in kept.tolist()} - {tuple(row) for row in before[sampled].tolist()}
    assert not lost
    # Points of a ray may miss a corner that it cuts.
    assert len(more) <= 0.02 * len(kept) and len(kept) < 0.5 * len(before)
    assert kept.dtype == before.dtype and {0, 1, 2} == set(kept[:, 0].tolist())
    rays = batches.draw(Needs())
    assert len(rays) == len(rays.targets) == 64
    views, pixels = pixels_of(orbit, rays)
    drawn = {
        (orbit.train.index(int(view)), *pixel)
        for view, pixel in zip(views, pixels.floor().long().tolist(), strict=True)
    }
    assert drawn <= {tuple(row) for row in kept.tolist()}


def test_grids_that_leave_everything_leave_all_pixels(orbit: Scene) -> None:
    batches = RayBatches(orbit, 64, torch.device("cpu"), torch.Generator().manual_seed(0))
    before = batches.pixels
    batches.keep_what_meets(grid_of(orbit, lambda at: at[..., 0] < 99))
    assert torch.equal(batches.pixels, before)


def test_several_grids_leave_what_meets_each(orbit: Scene) -> None:
    left, low = (
        grid_of(orbit, lambda at: at[..., 0] < -0.3),
        grid_of(orbit, lambda at: at[..., 2] < -0.3),
    )

    def kept(*grids: OccupancyGrid) -> set[tuple[int, ...]]:
        batches = RayBatches(orbit, 64, torch.device("cpu"), torch.Generator().manual_seed(0))
        for grid in grids:
            batches.keep_what_meets(grid)
        return {tuple(row) for row in batches.pixels.tolist()}

    assert kept(left, low) == kept(low, left) == kept(left) & kept(low)


def test_a_grid_without_cells_leaves_nothing_to_draw(orbit: Scene) -> None:
    batches = RayBatches(orbit, 64, torch.device("cpu"), torch.Generator().manual_seed(0))
    with pytest.raises(NerfregError, match="declare all space empty that training views see"):
        batches.keep_what_meets(grid_of(orbit, lambda at: at[..., 0] > 99))
