from __future__ import annotations

import logging
from pathlib import Path

import imageio.v3 as iio
import pytest
import torch
from safetensors.torch import save_file

from nerfreg.errors import NerfregError
from nerfreg.evaluation.lpips import LPIPS, load_lpips
from nerfreg.evaluation.metrics import psnr, ssim


@pytest.fixture
def lpips(data: Path) -> LPIPS:
    return LPIPS.load(data / "lpips" / "alexnet_v0.1.safetensors")


@pytest.fixture
def pair(data: Path) -> list[torch.Tensor]:
    folder = data / "nerf_llff_data" / "fern" / "images_8"
    return [
        torch.from_numpy(iio.imread(folder / f"image00{i}.png")).float() / 255 for i in range(2)
    ]


def test_values_of_the_official_packages(lpips, pair):
    # computed with the packages lpips 0.1 (net="alex") and torchmetrics on these two photographs
    assert lpips(*pair) == pytest.approx(0.225539, abs=2e-6)
    assert ssim(*pair) == pytest.approx(0.352886, abs=2e-6)
    assert psnr(*pair) == pytest.approx(15.6040, abs=1e-4)


def test_equal_images_are_at_distance_0_and_order_does_not_matter(lpips, pair):
    assert lpips(pair[0], pair[0]) == 0.0
    assert lpips(pair[1], pair[0]) == pytest.approx(lpips(*pair), abs=1e-6)


def test_blur_and_shift_are_at_a_distance_that_grows(lpips, pair):
    image = pair[0][:128, :128]
    distances = [lpips(image, image.roll(shift, dims=1)) for shift in (1, 4, 16)]
    assert 0 < distances[0] < distances[1] < distances[2]


def test_images_stay_as_they_were(lpips, pair):
    before = [x.clone() for x in pair]
    lpips(*pair)
    assert all(torch.equal(x, y) for x, y in zip(pair, before, strict=True))


def test_images_too_small_for_the_network_have_no_distance(lpips):
    # 31 -> (31 + 4 - 11) // 4 + 1 = 7 -> (7 - 3) // 2 + 1 = 3 -> 1; 30 leaves 6 -> 2 -> nothing
    assert lpips(torch.zeros(30, 64, 3), torch.ones(30, 64, 3)) is None
    assert lpips(torch.zeros(31, 31, 3), torch.ones(31, 31, 3)) > 0


def test_black_and_white_flat_images_have_a_finite_distance(lpips):
    assert 0 < lpips(torch.zeros(64, 64, 3), torch.ones(64, 64, 3)) < 2


def test_a_file_of_something_else_is_refused_by_name(tmp_path):
    other, text = tmp_path / "other.safetensors", tmp_path / "text.safetensors"
    save_file({"a": torch.zeros(1)}, other)
    text.write_text("not tensors")
    for path in (other, text):
        with pytest.raises(NerfregError, match=path.name):
            LPIPS.load(path)


def test_without_weights_one_line_says_how_to_get_them(monkeypatch, caplog):
    monkeypatch.setattr("nerfreg.evaluation.lpips.find_lpips_weights", lambda configured: None)
    with caplog.at_level(logging.WARNING):
        assert load_lpips(None) is None
    assert len(caplog.records) == 1
    message = caplog.records[0].getMessage()
    assert "\n" not in message
    assert "download https://" in message
    assert "eval.lpips_weights" in message
