from __future__ import annotations

import math

import imageio.v3 as iio
import numpy as np
import pytest
import torch

from nerfreg.errors import NerfregError
from nerfreg.evaluation.images import color_map, depth_image, save_png, side_by_side, to_uint8

# the two ends of viridis, as published with the colour map
VIRIDIS_FIRST = torch.tensor([0.267004, 0.004874, 0.329415])
VIRIDIS_LAST = torch.tensor([0.993248, 0.906157, 0.143936])


def test_bytes_are_rounded_and_clipped():
    # 0.25 * 255 = 63.75 -> 64, 1/255 -> 1, out of range clipped, nan black
    image = torch.tensor([[[0.25, 1 / 255, 2.0], [-1.0, math.nan, 1.0]]])
    assert to_uint8(image).tolist() == [[[64, 1, 255], [0, 0, 255]]]


def test_png_returns_the_same_bytes(tmp_path):
    image = torch.rand(5, 7, 3)
    save_png(tmp_path / "new" / "a.png", image)
    assert np.array_equal(iio.imread(tmp_path / "new" / "a.png"), to_uint8(image))
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["a.png"]


def test_png_that_fails_leaves_the_old_file_alone(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    save_png(path, torch.zeros(4, 4, 3))
    old = path.read_bytes()

    def full_disk(file, *args, **kwargs):
        file.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(iio, "imwrite", full_disk)
    with pytest.raises(
        NerfregError, match=r"a\.png: cannot be written \(No space left on device\)"
    ):
        save_png(path, torch.ones(4, 4, 3))
    assert path.read_bytes() == old
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


def test_a_folder_that_is_a_file_is_an_error_by_name(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(NerfregError, match=r"file/a\.png"):
        save_png(tmp_path / "file" / "a.png", torch.zeros(4, 4, 3))


def test_color_map_ends_and_beyond():
    values = torch.tensor([[0.0, 1.0, -5.0, 5.0]])
    expected = torch.stack([VIRIDIS_FIRST, VIRIDIS_LAST, VIRIDIS_FIRST, VIRIDIS_LAST])
    assert torch.allclose(color_map(values, "viridis")[0], expected, atol=1e-5)


def test_depth_is_bright_near_dark_far_and_black_where_empty():
    depth = torch.tensor([[2.0, 8.0, 8.0, 4.0]])
    opacity = torch.tensor([[1.0, 1.0, 0.0, 0.5]])
    image = depth_image(depth, 2.0, 8.0, opacity)
    assert torch.allclose(image[0, 0], VIRIDIS_LAST, atol=1e-5)
    assert torch.allclose(image[0, 1], VIRIDIS_FIRST, atol=1e-5)
    assert image[0, 2].tolist() == [0.0, 0.0, 0.0]
    # 4 is the geometric middle of 2 and 8
    middle = color_map(torch.tensor([[0.5]]), "viridis")[0, 0]
    assert torch.allclose(image[0, 3], 0.5 * middle, atol=1e-6)


def test_depth_image_of_a_scene_that_begins_at_the_camera_is_finite():
    image = depth_image(torch.tensor([[0.0, 1.0, math.inf]]), 0.0, 4.0, torch.ones(1, 3))
    assert image.isfinite().all()


def test_panels_stand_in_order():
    rgb, target = torch.rand(4, 5, 3), torch.rand(4, 5, 3)
    depth, opacity = torch.full((4, 5), 2.0), torch.ones(4, 5)
    two = side_by_side(rgb, depth, 1.0, 3.0, opacity)
    four = side_by_side(rgb, depth, 1.0, 3.0, opacity, target)
    assert two.shape == (4, 10, 3)
    assert four.shape == (4, 20, 3)
    assert torch.equal(four[:, :10], two)
    assert torch.equal(two[:, :5], rgb)
    assert torch.equal(two[:, 5:], depth_image(depth, 1.0, 3.0, opacity))
    assert torch.equal(four[:, 10:15], target)


def test_error_panel_is_dark_where_right_and_brightest_from_a_half():
    rgb = torch.zeros(1, 3, 3)
    target = torch.tensor([[[0.0, 0.0, 0.0], [0.5, 0.5, 0.5], [1.0, 1.0, 1.0]]])
    panel = side_by_side(rgb, torch.ones(1, 3), 1.0, 3.0, torch.ones(1, 3), target)[:, 9:]
    luminance = panel.sum(-1)[0]
    assert luminance[0] < 0.1
    assert luminance[1] == luminance[2] > 2.0
