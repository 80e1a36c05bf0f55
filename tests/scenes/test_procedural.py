from __future__ import annotations

import math

import pytest
import torch

from nerfreg.errors import NerfregError
from nerfreg.scenes import Procedural
from nerfreg.scenes.solids import BOX, CYLINDER, SPHERE, RayTracer, Solid, Texture

WHITE = Texture("stripes", torch.ones(2, 3), 1.0, torch.zeros(3))


def first_hit(solid: Solid, origin: list[float], direction: list[float]) -> float:
    distance, _ = RayTracer([solid]).trace(
        torch.tensor([origin], dtype=torch.float64), torch.tensor([direction], dtype=torch.float64)
    )
    return float(distance)


@pytest.mark.parametrize(
    ("solid", "origin", "direction", "expected"),
    [
        (Solid(SPHERE, (0.0, 0.0, 5.0), (1.0, 1.0, 1.0), WHITE), [0, 0, 0], [0, 0, 1], 4),
        # Half a radius off the centre: the surface is sqrt(3)/2 before it.
        (
            Solid(SPHERE, (0.0, 0.0, 5.0), (1.0, 1.0, 1.0), WHITE),
            [0.5, 0, 0],
            [0, 0, 1],
            5 - math.sqrt(3) / 2,
        ),
        (Solid(SPHERE, (0.0, 0.0, 5.0), (1.0, 1.0, 1.0), WHITE), [1.01, 0, 0], [0, 0, 1], math.inf),
        (Solid(SPHERE, (0.0, 0.0, 5.0), (1.0, 1.0, 1.0), WHITE), [0, 0, 0], [0, 0, -1], math.inf),
        (Solid(SPHERE, (0.0, 0.0, 5.0), (1.0, 1.0, 2.0), WHITE), [0, 0, 0], [0, 0, 1], 3),
        (Solid(BOX, (5.0, 0.0, 0.0), (1.0, 2.0, 3.0), WHITE), [0, 1.9, 0], [1, 0, 0], 4),
        (Solid(BOX, (5.0, 0.0, 0.0), (1.0, 2.0, 3.0), WHITE), [0, 2.1, 0], [1, 0, 0], math.inf),
        # Turned by 45 degrees, a cube of half side 1 has its edge sqrt(2) before its centre.
        (
            Solid(BOX, (5.0, 0.0, 0.0), (1.0, 1.0, 1.0), WHITE, rotation=math.pi / 4),
            [0, 0, 0],
            [1, 0, 0],
            5 - math.sqrt(2),
        ),
        (Solid(CYLINDER, (5.0, 0.0, 0.0), (1.0, 1.0, 1.0), WHITE), [0, 0.6, 0], [1, 0, 0], 5 - 0.8),
        (Solid(CYLINDER, (0.0, 0.0, 5.0), (1.0, 1.0, 2.0), WHITE), [0.5, 0.5, 0], [0, 0, 1], 3),
        (
            Solid(CYLINDER, (0.0, 0.0, 5.0), (1.0, 1.0, 2.0), WHITE),
            [0.8, 0.8, 0],
            [0, 0, 1],
            math.inf,
        ),
    ],
)
def test_distances_by_hand(solid, origin, direction, expected):
    assert first_hit(solid, origin, direction) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("shape", [SPHERE, BOX, CYLINDER])
def test_normals_point_at_the_viewer_and_away_from_the_middle(shape):
    solid = Solid(shape, (0.3, -0.2, 0.1), (0.5, 0.7, 0.9), WHITE, rotation=0.4)
    generator = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(
        torch.randn(500, 3, generator=generator).double(), dim=-1
    )
    origins = torch.tensor([0.3, -0.2, 0.1]).double() - 3 * directions
    distance, _ = RayTracer([solid]).trace(origins, directions)
    points = origins + distance[:, None] * directions
    _, normals = solid.surface(points)
    torch.testing.assert_close(normals.norm(dim=-1), torch.ones(500).double())
    assert ((normals * directions).sum(-1) < 0).all()
    # On a convex solid no other surface point lies in front of a tangent plane.
    ahead = (points[None] - points[:, None]) @ normals[:, :, None]
    assert float(ahead.max()) < 1e-6


def test_blinn_phong_by_hand():
    # Light, eye and normal all along x: full diffuse and full highlight: 0.5 * 1 + 0.3.
    gray = Texture("stripes", torch.full((2, 3), 0.5), 1.0, torch.zeros(3))
    tracer = RayTracer(
        [Solid(SPHERE, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), gray)], light=(1.0, 0.0, 0.0)
    )
    eye = torch.tensor([[3.0, 0, 0], [-3.0, 0, 0], [3.0, 5, 0]])
    colors, hit = tracer.shade(eye, torch.tensor([[-1.0, 0, 0], [1.0, 0, 0], [-1.0, 0, 0]]))
    assert hit.tolist() == [True, True, False]
    torch.testing.assert_close(colors[0], torch.full((3,), 0.8))
    # From behind only the ambient light: 0.4 * 0.5.
    torch.testing.assert_close(colors[1], torch.full((3,), 0.2))


def test_a_solid_between_lamp_and_surface_casts_a_shadow():
    balls = [Solid(SPHERE, (x, 0.0, 0.0), (1.0, 1.0, 1.0), WHITE) for x in (0.0, 4.0)]
    eye, direction = torch.tensor([[1.5, 0, 3.0]]), torch.tensor([[-0.5, 0, -3.0]])
    direction = direction / direction.norm()
    lit, _ = RayTracer(balls[:1], light=(1.0, 0.0, 0.0)).shade(eye, direction)
    dark, _ = RayTracer(balls, light=(1.0, 0.0, 0.0)).shade(eye, direction)
    assert float(dark.max()) == pytest.approx(0.4)
    assert float(lit.min()) > 0.5


def test_depth_of_the_scene_is_that_of_its_ball():
    # The ray to the middle of the small ball, seen from above all others, hits it one radius before
    # its middle.
    scene = Procedural(size=401, views=8).load()
    center, radius = torch.tensor([-0.52, -0.48, -0.28]), 0.22
    seen = 0
    for view in scene.train:
        x, y = scene.cameras.project(center[None], view)[0].floor().int().tolist()
        origin, direction = scene.cameras.rays(torch.tensor([view]), torch.tensor([[x, y]]))
        offset = (center - origin[0]).double()
        along = offset @ direction[0].double()
        expected = along - torch.sqrt(radius**2 - (offset @ offset - along**2))
        depth = scene.read_depth(view)[y, x]
        if depth > expected - 0.3 and depth < expected + 0.3:
            seen += 1
            assert float(depth) == pytest.approx(float(expected), abs=1e-5)
    assert seen >= 4


@pytest.mark.parametrize("layout", ["orbit", "forward"])
def test_depth_agrees_with_alpha_and_bounds(layout):
    scene = Procedural(size=48, layout=layout).load()
    for view in (*scene.train, *scene.test):
        image, depth = scene.read_image(view), scene.read_depth(view)
        assert image.shape == (48, 48, 4 if layout == "orbit" else 3)
        assert 0 <= float(image.min()) <= float(image.max()) <= 1
        hit = depth.isfinite()
        if layout == "orbit":
            assert (hit[image[..., 3] == 1]).float().mean() > 0.99
            assert not hit[image[..., 3] == 0].any()
            assert image[..., 3].unique().tolist() == [0, 0.25, 0.5, 0.75, 1]
            assert (image[[0, -1], :, 3] == 0).all(), "the solids fit into the image"
        else:
            assert hit.all()
        assert scene.near < float(depth[hit].min()) < float(depth[hit].max()) < scene.far
        origins, directions = scene.cameras.image_rays(view)
        points = (origins + depth.reshape(-1, 1) * directions)[hit.reshape(-1)]
        inside = ((points > scene.box[0]) & (points < scene.box[1])).all(-1).float().mean()
        assert inside == 1 if view in scene.train else inside > 0.98


def test_depth_maps_of_two_views_agree():
    # A surface point seen in one view, projected into another where it is seen too, lies at the
    # distance that this view's depth map says.
    scene = Procedural(size=200).load()
    depth = scene.read_depth(1)
    origins, directions = scene.cameras.image_rays(1)
    points = (origins + depth.reshape(-1, 1) * directions)[depth.isfinite().reshape(-1)]
    other = 6
    pixels = scene.cameras.project(points, other).floor().long()
    there = scene.read_depth(other)[pixels[:, 1], pixels[:, 0]]
    distance = (points - scene.cameras.positions[other]).norm(dim=-1)
    visible = (there - distance).abs() < 0.02
    assert visible.float().mean() > 0.4
    # Nothing is seen through: some neighbour (the point may lie on an outline) is no farther than
    # the point.
    nearest = -torch.nn.functional.max_pool2d(
        -scene.read_depth(other)[None], 3, stride=1, padding=1
    )[0]
    assert (nearest[pixels[:, 1], pixels[:, 0]] < distance + 0.05).all()


def test_training_and_test_views_do_not_depend_on_each_other():
    few, many = Procedural(views=4, test_views=5).load(), Procedural(views=9, test_views=5).load()
    torch.testing.assert_close(
        few.cameras.poses[list(few.test)], many.cameras.poses[list(many.test)]
    )
    assert few.train == (0, 1, 2, 3)
    assert few.test == (4, 5, 6, 7, 8)


@pytest.mark.parametrize("layout", ["orbit", "forward"])
@pytest.mark.parametrize("counts", [(1, 1), (3, 1), (8, 8), (9, 9), (3, 40), (5, 2)])
def test_no_test_camera_stands_on_a_training_camera(layout, counts):
    scene = Procedural(layout=layout, size=8, views=counts[0], test_views=counts[1]).load()
    positions = scene.cameras.positions
    distances = torch.cdist(positions[list(scene.train)], positions[list(scene.test)])
    assert float(distances.min()) > 0.02


def test_seed_changes_colors_only_and_images_repeat():
    first, again, other = (Procedural(size=32, seed=seed).load() for seed in (0, 0, 1))
    assert torch.equal(first.read_image(3), again.read_image(3))
    assert not torch.allclose(first.read_image(3), other.read_image(3))
    assert torch.equal(first.read_depth(3), other.read_depth(3))
    assert first.read_image(3) is first.read_image(3)


def test_options():
    scene = Procedural(size=30, height=20, background="black").load()
    assert scene.read_image(0).shape == (20, 30, 4)
    assert scene.background.tolist() == [0, 0, 0]
    split = Procedural(split="every_8").load()
    assert split.test == (0, 8)
    assert Procedural(train=[3], test=[4]).load().train == (3,)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"views": 0}, "scene.views=0"),
        ({"size": 0}, "scene.size=0"),
        ({"layout": "orbits"}, "scene.layout=orbits: unknown; did you mean 'orbit'"),
        (
            {"layout": "room"},
            "scene.layout=room: procedural photographs from all around have alpha",
        ),
        ({"background": "blue"}, "scene.background=blue"),
        ({"near": 9.0}, "scene.near=9: must be less than scene.far"),
        ({"far": -1.0}, "scene.far=-1.0: must be positive"),
        ({"box": [[0.0, 0.0, 0.0]]}, "two corners"),
        ({"box": [[0, 0, "a"], [1, 1, 1]]}, "two corners"),
        ({"box": [1, 2, 3]}, "two corners"),
        ({"box": [[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]]}, "first corner must be below"),
    ],
)
def test_refused(values, message):
    with pytest.raises(NerfregError) as error:
        Procedural(**values).load()
    assert message in str(error.value)


def test_highlights_move_with_the_viewer():
    # Halfway between light and eye turns half as far as the eye does: the same point of a glossy
    # ball looks different.
    black = Texture("stripes", torch.zeros(2, 3), 1.0, torch.zeros(3))
    tracer = RayTracer(
        [Solid(SPHERE, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), black, gloss=0.5)], light=(1.0, 0.0, 0.0)
    )
    angle = math.radians(40)
    eyes = torch.tensor([[3.0, 0, 0], [1 + 2 * math.cos(angle), 2 * math.sin(angle), 0]])
    colors, _ = tracer.shade(
        eyes, torch.nn.functional.normalize(torch.tensor([1.0, 0, 0]) - eyes, dim=-1)
    )
    torch.testing.assert_close(colors[0], torch.full((3,), 0.5))
    torch.testing.assert_close(colors[1], torch.full((3,), 0.5 * math.cos(angle / 2) ** 30))
