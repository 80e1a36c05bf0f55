from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest

from nerfreg.errors import NerfregError
from nerfreg.scenes import LLFF, Blender, SceneConfig, Transforms


def refused(config: SceneConfig, *parts: str) -> None:
    with pytest.raises(NerfregError) as error:
        scene = config.load()
        for view in (*scene.train, *scene.test):
            scene.read_image(view)
    message = str(error.value)
    assert "\n" not in message
    for part in parts:
        assert part in message, message


def change(path: Path, edit: Callable[[dict], object]) -> None:
    content = json.loads(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))


def test_path(tmp_path):
    refused(LLFF(), "scene.path: not set")
    refused(LLFF(path=str(tmp_path / "none")), "scene.path=", "no such file or folder")
    refused(Blender(path=str(tmp_path)), "transforms_train.json: missing")
    refused(Transforms(path=str(tmp_path)), "transforms.json: missing")
    refused(LLFF(path=str(tmp_path)), "poses_bounds.npy: missing")


def test_json(transforms):
    transforms.write_text("{")
    refused(Transforms(path=str(transforms)), str(transforms), "cannot be read as JSON")
    transforms.write_text("[]")
    refused(Transforms(path=str(transforms)), "not a list")
    transforms.write_text('{"frames": []}')
    refused(Transforms(path=str(transforms)), "at least one frame")


def test_images(transforms):
    image = transforms.parent / "images" / "3.png"
    iio.imwrite(image, np.zeros((5, 8, 3), np.uint8))
    refused(Transforms(path=str(transforms)), "3.png: is 8 x 5 pixels", "1.png is 8 x 6")
    iio.imwrite(image, np.zeros((6, 8, 4), np.uint8))
    refused(Transforms(path=str(transforms)), "1.png: has no alpha channel", "3.png has")
    image.write_bytes(b"no image")
    refused(Transforms(path=str(transforms)), "3.png: cannot be read as an image")
    image.unlink()
    refused(Transforms(path=str(transforms)), "3.png: image is missing")


def test_an_image_that_ends_too_early(blender):
    path = blender / "train" / "r_0.png"
    path.write_bytes(path.read_bytes()[:-30])
    refused(Blender(path=str(blender)), "r_0.png: cannot be read as an image")


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (
            lambda c: c["frames"][2].pop("transform_matrix"),
            "frame 2: key 'transform_matrix' is missing",
        ),
        (lambda c: c["frames"][2].pop("file_path"), "frame 2: key 'file_path' is missing"),
        (
            lambda c: c["frames"][2].update(transform_matrix=[[1, 2], [3, 4]]),
            "frame 2: 'transform_matrix' must be 4 x 4",
        ),
        (
            lambda c: c["frames"][2].update(transform_matrix=[[1, 2], [3]]),
            "frame 2: 'transform_matrix' must be 4 x 4",
        ),
        (
            lambda c: c["frames"][2]["transform_matrix"][0].__setitem__(3, float("nan")),
            "frame 2: the pose holds NaN",
        ),
        (
            lambda c: c["frames"][2]["transform_matrix"][0].__setitem__(0, 1.1),
            "frame 2: the pose is not rigid",
        ),
        (
            lambda c: c["frames"][2]["transform_matrix"][0].__setitem__(0, -1),
            "frame 2: the pose is not rigid; it mirrors",
        ),
        (lambda c: c.pop("fl_x"), "'fl_x' and 'camera_angle_x' are missing"),
        (lambda c: c.update(fl_x="long"), "'fl_x' must be a number, not 'long'"),
        (lambda c: c.update(fl_x=0), "focal length along x is 0"),
        (
            lambda c: c.update(camera_model="OPENCV_FISHEYE"),
            "camera model OPENCV_FISHEYE is not supported",
        ),
        (lambda c: c.update(k4=0.1), "fisheye"),
        (lambda c: c.update(k1=-2.0, fl_x=4, fl_y=4), "folds the image over itself"),
        (lambda c: c.update(w=8, h=8), "not a smaller version"),
        (
            lambda c: c.update(train_filenames=["images/77.png"]),
            "'train_filenames' names images/77.png",
        ),
        (lambda c: c.update(train_filenames=["images/1.png"]), "must both name images"),
    ],
)
def test_transforms(transforms, edit, message):
    change(transforms, edit)
    refused(Transforms(path=str(transforms)), str(transforms), message)


def test_views_and_factor(transforms, blender):
    refused(Transforms(path=str(transforms), views=8), "scene.views=8: there are only 7")
    refused(
        Transforms(path=str(transforms), factor=7),
        "scene.factor=7: must lie between 1 and the image size, 8 x 6",
    )
    refused(Blender(path=str(blender), factor=0), "scene.factor=0")
    refused(Blender(path=str(blender), views=3), "scene.views=3: there are only 2")


def test_blender_angle(blender):
    change(blender / "transforms_test.json", lambda c: c.pop("camera_angle_x"))
    refused(Blender(path=str(blender)), "transforms_test.json: key 'camera_angle_x' is missing")
    change(blender / "transforms_train.json", lambda c: c.update(camera_angle_x=4.0))
    refused(Blender(path=str(blender)), "'camera_angle_x' is 4.0")


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda rows: rows[:, :16], "must have shape (images, 17), not (3, 16)"),
        (lambda rows: rows[0], "must have shape (images, 17), not (17,)"),
        (lambda rows: rows[:2], "holds 3 images, but"),
        (lambda rows: rows * np.where(np.arange(17) == 3, np.nan, 1), "row 0: the pose holds NaN"),
        (lambda rows: rows * np.where(np.arange(17) == 1, 2, 1), "row 0: the pose is not rigid"),
        (lambda rows: rows * np.where(np.arange(17) == 14, 0, 1), "focal length must be positive"),
        (lambda rows: rows * np.where(np.arange(17) == 16, 0.1, 1), "must be 0 < near < far"),
        (lambda rows: rows.astype(str), "must hold real numbers"),
    ],
)
def test_poses_bounds(llff, edit, message):
    path = llff / "poses_bounds.npy"
    np.save(path, edit(np.load(path)))
    refused(LLFF(path=str(llff)), str(path), message)


def test_llff_folders(llff):
    refused(LLFF(path=str(llff), factor=8), "scene.factor=8", "has images for factor 10")
    (llff / "poses_bounds.npy").write_bytes(b"")
    refused(LLFF(path=str(llff)), "cannot be read as a numpy array")
