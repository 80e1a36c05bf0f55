from __future__ import annotations

import math

import pytest
import torch

from nerfreg.evaluation.metrics import average, depth_rmse, psnr, ssim


def flat(value: float, height: int = 16, width: int = 20) -> torch.Tensor:
    return torch.full((height, width, 3), value)


def noise(seed: int = 0) -> torch.Tensor:
    return torch.rand(24, 32, 3, generator=torch.Generator().manual_seed(seed))


def test_psnr_of_a_constant_difference_of_a_tenth_is_20_db():
    # MSE 0.01, -10 log10(0.01) = 20
    assert psnr(flat(0.5), flat(0.6)) == pytest.approx(20.0, abs=1e-4)


def test_psnr_of_one_wrong_channel_value_counts_over_all_values():
    # one of 16 * 20 * 3 = 960 values is off by 1: MSE 1/960, 10 log10(960) = 29.8227
    image = flat(0.0)
    image[3, 4, 1] = 1.0
    assert psnr(image, flat(0.0)) == pytest.approx(29.82271, abs=1e-4)


def test_psnr_of_black_against_white_is_0_and_of_equal_images_is_infinite():
    assert psnr(flat(0.0), flat(1.0)) == 0.0
    assert psnr(noise(), noise()) == math.inf


def test_psnr_of_nan_is_nan():
    assert math.isnan(psnr(flat(math.nan), flat(0.5)))


def test_ssim_of_equal_images_is_1():
    assert ssim(noise(), noise()) == pytest.approx(1.0, abs=1e-6)


def test_ssim_of_flat_images_is_the_luminance_term():
    # variances are 0, so SSIM = (2ab + C1) / (a^2 + b^2 + C1), C1 = (0.01 * 1)^2: 0.6001 / 0.6101
    assert ssim(flat(0.5), flat(0.6)) == pytest.approx(0.6001 / 0.6101, abs=1e-5)


def test_ssim_range_is_1_whatever_the_contrast_of_the_images():
    # a flat image against its noise of deviation s: contrast * structure = C2 / (s^2 + C2) with
    # C2 = (0.03 * 1)^2, times a luminance term near 1. Averaged over windows of noise with s = 0.03
    # this is close to a half.
    dim = 0.5 + 0.03 * torch.randn(64, 64, 3, generator=torch.Generator().manual_seed(1))
    assert ssim(flat(0.5, 64, 64), dim) == pytest.approx(0.5, abs=0.05)


def test_ssim_needs_eleven_pixels():
    assert ssim(flat(0.5, 10, 40), flat(0.5, 10, 40)) is None
    assert ssim(flat(0.5, 11, 11), flat(0.5, 11, 11)) == pytest.approx(1.0, abs=1e-6)


def test_scores_are_symmetric_and_a_shifted_image_scores_worse():
    image = torch.nn.functional.avg_pool2d(noise(3).movedim(-1, 0), 5, 1, 2).movedim(0, -1)
    shifted, shifted_far = image.roll(1, dims=1), image.roll(3, dims=1)
    for score in (psnr, ssim):
        assert score(image, shifted) == pytest.approx(score(shifted, image), abs=1e-6)
        assert score(image, image) > score(image, shifted) > score(image, shifted_far)


def test_average_is_the_geometric_mean_of_three_errors():
    # 20 dB -> 10^-2; SSIM 0.75 -> sqrt(0.25) = 0.5; LPIPS 0.2:
    # (0.01 * 0.5 * 0.2)^(1/3) = 0.001^(1/3) = 0.1
    assert average(20.0, 0.75, 0.2) == pytest.approx(0.1, rel=1e-9)


@pytest.mark.parametrize(
    ("scores"), [(math.inf, 0.9, 0.1), (20.0, 1.0, 0.1), (20.0, 1.0 + 1e-7, 0.1), (20.0, 0.9, 0.0)]
)
def test_average_is_0_where_one_error_is_0(scores):
    assert average(*scores) == 0.0


def test_average_is_unknown_where_one_score_is():
    assert average(20.0, 0.9, None) is None
    assert average(20.0, None, 0.1) is None


def test_average_of_a_negative_ssim():
    # 0 dB, SSIM -1, LPIPS 1: sqrt(2)^(1/3) = 2^(1/6)
    assert average(0.0, -1.0, 1.0) == pytest.approx(2 ** (1 / 6))


def test_depth_error_counts_only_where_the_truth_is_finite():
    # errors 3 and 4 at the two finite pixels: sqrt((9 + 16) / 2); the third pixel is sky
    depth, truth = torch.tensor([[5.0, 2.0, 10.0]]), torch.tensor([[2.0, 6.0, math.inf]])
    assert depth_rmse(depth, truth) == pytest.approx(math.sqrt(12.5))


def test_depth_error_of_a_hole_is_its_distance_to_far():
    assert depth_rmse(torch.tensor([[10.0]]), torch.tensor([[4.0]])) == 6.0


def test_depth_error_without_any_surface_is_unknown():
    assert depth_rmse(torch.ones(2, 2), torch.full((2, 2), math.inf)) is None


def test_arguments_stay_as_they_were():
    image, target = noise(1), noise(2)
    depth, truth = torch.tensor([[1.0, 2.0]]), torch.tensor([[math.inf, 3.0]])
    before = [x.clone() for x in (image, target, depth, truth)]
    psnr(image, target), ssim(image, target), depth_rmse(depth, truth)
    assert all(
        torch.equal(x, y) for x, y in zip((image, target, depth, truth), before, strict=True)
    )
