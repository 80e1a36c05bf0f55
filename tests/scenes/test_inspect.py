from __future__ import annotations

import imageio.v3 as iio
import numpy as np
import pytest

from nerfreg.errors import NerfregError
from nerfreg.scenes import LLFF, Procedural, Transforms
from nerfreg.scenes.inspect import TEST_COLOR, TRAIN_COLOR, describe, draw_cameras


def test_describe(llff):
    text = describe(LLFF(path=str(llff), train=[1, 2], test=[2]).load())
    for line in (
        "images        3 known, 8 x 6 pixels",
        "focal length  10 x 10 pixels",
        # 2 atan(0.4) and 2 atan(0.3)
        "field of view 43.6 x 33.4 degrees",
        "distortion    none",
        "training      2 views: 1, 2",
        "depth         unknown",
        "views 2 are used for both training and test",
    ):
        assert line in text


def test_describe_says_what_was_found(llff, transforms):
    named = describe(LLFF(path=str(llff)).load())
    assert "layout        forward (photographs side by side)\n" in named
    found = describe(Transforms(path=str(transforms)).load())
    line = "forward (photographs side by side); scene.layout=object or room overrides"
    assert f"scene         {transforms.parent.name}\nlayout        {line}\n" in found


@pytest.mark.parametrize("layout", ["object", "forward"])
@pytest.mark.parametrize("views", [1, 8])
def test_the_picture_shows_both_kinds_of_cameras(tmp_path, layout, views):
    path = tmp_path / "cameras.png"
    draw_cameras(Procedural(layout=layout, size=8, views=views).load(), path)
    pixels = iio.imread(path)[..., :3].astype(int)
    for color in (TRAIN_COLOR, TEST_COLOR):
        rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
        halves = np.array_split((np.abs(pixels - rgb).sum(-1) < 12), 2, axis=1)
        assert all(half.sum() > 20 for half in halves)


def test_unwritable(tmp_path, transforms):
    scene = Transforms(path=str(transforms)).load()
    with pytest.raises(NerfregError, match="cannot be written"):
        draw_cameras(scene, tmp_path / "none" / "cameras.png")
