from __future__ import annotations

import json
import math
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
import torch

from nerfreg.scenes import LLFF, SCENES, Blender, Procedural, Transforms, load_scene
from nerfreg.scenes.images import read_image, reduce


def edit(path: Path, **changes: object) -> None:
    content = json.loads(path.read_text())
    content.update(changes)
    path.write_text(json.dumps(content))


def test_registry():
    assert list(SCENES) == ["procedural", "blender", "llff", "transforms"]
    assert load_scene(SCENES["procedural"]()).layout == "object"


def test_reduce_weighs_colors_by_alpha():
    # Four pixels: red at alpha 1, green at alpha 0.5, two invisible blue ones. Premultiplied mean:
    # (1, 0.5, 0) / 4, alpha 1.5 / 4; straight colour (2/3, 1/3, 0).
    image = torch.tensor([[[1.0, 0, 0, 1], [0, 1, 0, 0.5]], [[0, 0, 1, 0], [0, 0, 1, 0]]])
    torch.testing.assert_close(reduce(image, 2), torch.tensor([[[2 / 3, 1 / 3, 0, 0.375]]]))
    assert torch.equal(reduce(torch.zeros(2, 2, 4), 2), torch.zeros(1, 1, 4))


def test_reduce_drops_what_fills_no_block():
    image = torch.arange(15.0).reshape(3, 5, 1).expand(3, 5, 3)
    # Blocks of the first two rows: (0 + 1 + 5 + 6) / 4 = 3, (2 + 3 + 7 + 8) / 4 = 5.
    assert reduce(image, 2)[..., 0].tolist() == [[3.0, 5.0]]


@pytest.mark.parametrize(
    ("pixels", "expected"),
    [
        (np.full((1, 1), 51, np.uint8), [0.2, 0.2, 0.2]),
        (np.full((1, 1, 2), 51, np.uint8), [0.2, 0.2, 0.2, 0.2]),
        (np.array([[[0, 51, 255]]], np.uint8), [0, 0.2, 1]),
        (np.full((1, 1), 13107, np.uint16), [0.2, 0.2, 0.2]),
    ],
)
def test_gray_alpha_and_16_bits(tmp_path, pixels, expected):
    iio.imwrite(tmp_path / "image.png", pixels)
    torch.testing.assert_close(
        read_image(tmp_path / "image.png")[0, 0], torch.tensor(expected, dtype=torch.float32)
    )


def test_blender(blender):
    scene = Blender(path=str(blender)).load()
    # Angle 90 degrees: the focal length is half the width, 4, and 2 at half size.
    assert (scene.cameras.width, scene.cameras.height) == (4, 4)
    assert scene.cameras.focal[0].tolist() == pytest.approx([2, 2])
    assert scene.cameras.center[0].tolist() == [2, 2]
    assert (scene.train, scene.test, scene.layout) == ((0, 1), (2, 3), "object")
    assert scene.labels == ("train/r_0", "train/r_1", "test/r_0", "test/r_1")
    # Distance 2, half field 45 degrees: radius sqrt(2); the ball around the box has sqrt(6) and
    # holds the cameras.
    half_side = math.sqrt(2)
    torch.testing.assert_close(scene.box, torch.tensor([[-half_side] * 3, [half_side] * 3]))
    assert scene.near == pytest.approx(0.05 * 2)
    assert scene.far == pytest.approx(2 + math.sqrt(6))
    assert scene.has_alpha
    assert scene.read_image(0).shape == (4, 4, 4)
    assert float(scene.read_image(0)[0, 0, 0]) == pytest.approx(128 / 255)


def test_blender_reads_only_the_split(blender):
    (blender / "train" / "r_1.png").unlink()
    scene = Blender(path=str(blender), train=[0]).load()
    assert scene.train == (0,)
    assert len(scene.cameras) == 4


def test_llff(llff):
    scene = LLFF(path=str(llff), background="black").load()
    # 80 pixels became 8, so the focal length 100 became 10. The mean position is the new origin.
    assert scene.cameras.focal[0].tolist() == pytest.approx([10, 10])
    expected = torch.eye(3).repeat(3, 1, 1)
    torch.testing.assert_close(scene.cameras.poses[:, :, :3], expected)
    torch.testing.assert_close(
        scene.cameras.positions, torch.tensor([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0]])
    )
    assert (scene.train, scene.test, scene.layout) == ((1, 2), (0,), "forward")
    assert scene.labels == ("0", "1", "2")
    # Training bounds: 1.5 to 11 and 1 to 12, so planes at 0.9 and 13.2. The corner ray is longer
    # than its depth by sqrt(1 + 0.4^2 + 0.3^2), and views 1 and 2 stand at x = 0 and 1.
    assert scene.near == pytest.approx(0.9)
    assert scene.far == pytest.approx(13.2 * math.sqrt(1.25), rel=1e-5)
    low, high = [-0.4 * 13.2, -0.3 * 13.2, -13.2], [1 + 0.4 * 13.2, 0.3 * 13.2, -0.9]
    torch.testing.assert_close(scene.box, torch.tensor([low, high]))
    assert scene.background is None


def test_llff_takes_the_smallest_images_or_the_chosen_ones(llff):
    for folder, size in (("images_5", (16, 12)), ("images", (80, 60))):
        for index in range(3):
            (llff / folder).mkdir(exist_ok=True)
            iio.imwrite(llff / folder / f"{index}.png", np.zeros((size[1], size[0], 3), np.uint8))
    assert LLFF(path=str(llff)).load().cameras.width == 8
    assert LLFF(path=str(llff), factor=5).load().cameras.width == 16
    scene = LLFF(path=str(llff), factor=1).load()
    assert scene.cameras.focal[0].tolist() == pytest.approx([100, 100])


def test_transforms(transforms):
    for path in (transforms, transforms.parent):
        scene = Transforms(path=str(path)).load()
        assert scene.cameras.focal[0].tolist() == [10, 12]
        assert scene.cameras.center[0].tolist() == [3.5, 2.5]
        assert (scene.train, scene.test) == ((1, 2, 3, 4, 5, 6, 7), (0, 8))
        assert scene.layout == "forward"
        assert scene.name == transforms.parent.name
        torch.testing.assert_close(scene.cameras.positions[3], torch.tensor([0.3, 0, 2]))


def test_transforms_scales_intrinsics_to_the_images(transforms):
    edit(transforms, w=16, h=12)
    scene = Transforms(path=str(transforms)).load()
    assert scene.cameras.focal[0].tolist() == [5, 6]
    assert scene.cameras.center[0].tolist() == [1.75, 1.25]
    half = Transforms(path=str(transforms), factor=2).load()
    assert half.cameras.focal[0].tolist() == [2.5, 3]
    assert half.read_image(0).shape == (3, 4, 3)


def test_transforms_per_frame_intrinsics_and_missing_extensions(transforms):
    content = json.loads(transforms.read_text())
    for frame in content["frames"]:
        frame["file_path"] = "./" + frame["file_path"].removesuffix(".png")
    content["frames"][2] |= {"fl_x": 20.0, "k1": 0.1, "p2": 0.01}
    del content["fl_x"], content["fl_y"], content["cx"], content["cy"]
    content["camera_angle_x"] = math.pi / 2
    transforms.write_text(json.dumps(content))
    scene = Transforms(path=str(transforms)).load()
    assert scene.cameras.focal[0].tolist() == pytest.approx([4, 4])
    assert scene.cameras.focal[2].tolist() == pytest.approx([20, 20])
    assert scene.cameras.center[0].tolist() == [4, 3]
    torch.testing.assert_close(scene.cameras.distortion[2], torch.tensor([0.1, 0, 0, 0.01, 0]))
    assert not scene.cameras.distortion[1].any()


def test_transforms_honours_its_own_split(transforms):
    lists = {
        "train_filenames": [f"images/{i}.png" for i in (5, 1, 2)],
        "test_filenames": ["./images/3.png"],
    }
    edit(transforms, **lists)
    assert Transforms(path=str(transforms)).load().train == (5, 1, 2)
    assert Transforms(path=str(transforms)).load().test == (3,)
    assert Transforms(path=str(transforms), views=2).load().train == (5, 2)
    assert Transforms(path=str(transforms), split="every_8").load().test == (0, 8)


def test_given_bounds_win(transforms):
    box = [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]
    scene = Transforms(path=str(transforms), near=0.5, far=7.0, box=box).load()
    assert (scene.near, scene.far, scene.box.tolist()) == (0.5, 7.0, box)


def test_the_same_scene_written_in_two_formats_has_the_same_rays(tmp_path):
    """Rays of one scene as LLFF and as transforms.json agree up to LLFF's rigid motion."""
    scene = Procedural(layout="forward", size=16, height=12, views=5, test_views=4).load()
    poses = scene.cameras.poses.double().numpy()
    focal = float(scene.cameras.focal[0, 0])
    rows, frames = [], []
    (tmp_path / "images").mkdir()
    for view, pose in enumerate(poses):
        right, up, back, position = pose.T
        matrix = np.stack((-up, right, back, position, np.array([12, 16, focal])), axis=1)
        rows.append([*matrix.ravel(), 1.0, 8.0])
        iio.imwrite(
            tmp_path / "images" / f"{view}.png",
            (scene.read_image(view).numpy() * 255).astype(np.uint8),
        )
        frames.append(
            {"file_path": f"images/{view}", "transform_matrix": [*pose.tolist(), [0, 0, 0, 1]]}
        )
    np.save(tmp_path / "poses_bounds.npy", np.array(rows))
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": focal, "frames": frames}))
    views, pixels = torch.tensor([0, 3, 7]), torch.tensor([[0, 0], [15, 11], [4, 9]])
    expected = scene.cameras.rays(views, pixels)
    actual = Transforms(path=str(tmp_path)).load().cameras.rays(views, pixels)
    torch.testing.assert_close(actual, expected)
    moved = LLFF(path=str(tmp_path)).load().cameras.rays(views, pixels)
    torch.testing.assert_close(
        torch.cdist(moved[0], moved[0]), torch.cdist(expected[0], expected[0])
    )
    torch.testing.assert_close(moved[1] @ moved[1].T, expected[1] @ expected[1].T)


def test_chair(data):
    scene = Blender(path=str(data / "nerf_synthetic" / "chair")).load()
    assert scene.labels[scene.train[0]] == "train/r_26"
    assert scene.labels[scene.test[-1]] == "test/r_199"
    assert (len(scene.train), len(scene.test), len(scene.cameras)) == (8, 25, 300)
    # Blender's cameras stand 4.0311 from the origin; half the angle is 0.34556:
    # 4.0311 sin(0.34556) = 1.3654.
    torch.testing.assert_close(
        scene.box, torch.tensor([[-1.3654] * 3, [1.3654] * 3]), atol=1e-3, rtol=0
    )
    assert scene.cameras.focal[0, 0] == pytest.approx(1111.111 / 2, rel=1e-5)
    # The chair stands around the origin: the middle of what is opaque lies near the projected
    # centre of the box.
    for view in (*scene.train[:3], *scene.test[::8]):
        alpha = scene.read_image(view)[..., 3]
        y, x = torch.meshgrid(torch.arange(400) + 0.5, torch.arange(400) + 0.5, indexing="ij")
        centroid = torch.stack(((x * alpha).sum(), (y * alpha).sum())) / alpha.sum()
        projected = scene.cameras.project(scene.box.mean(0)[None], view)[0]
        assert float((centroid - projected).norm()) < 40


def test_chair_fills_one_and_the_same_space_in_all_views(data):
    """The hull of the alpha masks of all 8 views is not empty, as it would be with a wrong axis."""
    scene = Blender(path=str(data / "nerf_synthetic" / "chair"), factor=8).load()
    axis = torch.linspace(-1.2, 1.2, 25)
    points = torch.cartesian_prod(axis, axis, axis)
    inside = torch.ones(len(points), dtype=torch.bool)
    for view in scene.train:
        alpha = scene.read_image(view)[..., 3]
        x, y = scene.cameras.project(points, view).floor().long().clamp(0, 99).unbind(-1)
        inside &= alpha[y, x] > 0.5
    hull = points[inside]
    assert 0.02 < inside.float().mean() < 0.4
    # The chair is taller than it is wide, along z.
    extent = hull.amax(0) - hull.amin(0)
    assert extent[2] > 1.5
    assert extent.argmax() == 2


def test_fern(data):
    scene = LLFF(path=str(data / "nerf_llff_data" / "fern"), views=3).load()
    assert (scene.train, scene.test) == ((1, 10, 19), (0, 8, 16))
    assert (scene.cameras.width, scene.cameras.height) == (504, 378)
    assert scene.cameras.focal[0].tolist() == pytest.approx([3260.52633 / 8] * 2)
    # Bounds of images 1, 10 and 19 are (18.917, 77.387), (17.941, 78.719) and (17.543, 76.716).
    assert scene.near == pytest.approx(0.9 * 17.54252, rel=1e-5)
    corner = math.sqrt(1 + (252**2 + 189**2) / 407.5658**2)
    assert scene.far == pytest.approx(1.1 * 78.719253 * corner, rel=1e-4)
    assert scene.cameras.axes.mean(0)[2] < -0.99
    assert scene.read_image(0).shape == (378, 504, 3)


def test_held_out_training_views_are_scored_and_no_test_image_is_read(blender, llff, transforms):
    for image in (blender / "test").iterdir():
        image.unlink()
    scene = Blender(path=str(blender), held_out=[1]).load()
    assert (scene.train, scene.test) == ((0,), (1,))
    # Bounds come from what trains: view 2 stands at x = 1, and nothing is known of view 1.
    scene = LLFF(path=str(llff), held_out=[0]).load()
    assert (scene.train, scene.test) == ((2,), (1,))
    assert float(scene.box[0, 0]) == pytest.approx(1 - 0.4 * scene.box[0, 2].abs())
    scene = Transforms(path=str(transforms), held_out=[0, 6]).load()
    assert (scene.train, scene.test) == ((2, 3, 4, 5, 6), (1, 7))
    scene = Procedural(size=8, views=3, held_out=[2]).load()
    assert (scene.train, scene.test, scene.labels[2]) == ((0, 1), (2,), "train/2")
