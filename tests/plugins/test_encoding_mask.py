from __future__ import annotations

import pytest
import torch
from nerfreg_plugins.encoding_mask import EncodingMask, MaskedNetwork, active_features, feature_mask

from nerfreg import Regularizer, Samples
from nerfreg.registry import Hooks

POSITIONS = torch.zeros(2, 3, 3)
SAMPLES = Samples(POSITIONS, torch.zeros(2, 3), torch.zeros(2, 3), density_width=32, color_width=16)


@pytest.mark.parametrize(
    ("count", "ratio", "kept"),
    [
        (32, 0.0, 0),
        (32, 0.03, 0),
        (32, 1 / 32, 1),
        (32, 0.5, 16),
        (32, 0.999, 31),
        (32, 1.0, 32),
        (16, 0.99, 15),
    ],
)
def test_floor_of_the_share_is_kept(count, ratio, kept):
    assert active_features(count, ratio) == kept
    mask = feature_mask(torch.ones(2, count), ratio)
    assert mask.tolist() == [[1.0] * kept + [0.0] * (count - kept)] * 2


@pytest.mark.parametrize("ratio", [0.0, 0.1, 1 / 3, 0.7, 1.0])
def test_the_count_means_the_same_as_the_mask(ratio):
    # How the core reads a count: feature i times clip(count - i, 0, 1).
    features = torch.rand(5, 20, generator=torch.Generator().manual_seed(0))
    core = features * (active_features(20, ratio) - torch.arange(20)).clamp(0, 1)
    assert torch.equal(feature_mask(features, ratio), core)


def test_masked_features_get_no_gradient_even_if_they_are_not_finite():
    features = torch.tensor([[1.0, 2.0, float("inf"), float("nan")]], requires_grad=True)
    feature_mask(features, 0.5).sum().backward()
    assert features.grad is not None
    assert features.grad.tolist() == [[1.0, 1.0, 0.0, 0.0]]


@pytest.mark.parametrize(("ratio", "kept"), [(-0.5, 0), (1.5, 8)])
def test_ratios_outside_of_0_and_1_are_clipped(ratio, kept):
    assert active_features(8, ratio) == active_features(8, ratio, fractional=True) == kept


def test_fractional():
    assert active_features(10, 0.25, fractional=True) == 2.5


@pytest.mark.parametrize(
    ("initial", "saturation", "fraction", "ratio"),
    [
        (0.0, 0.9, 0.0, 0.0),
        (0.0, 0.9, 0.45, 0.5),
        (0.0, 0.9, 0.9, 1.0),
        (0.0, 0.9, 1.0, 1.0),
        (0.5, 0.2, 0.1, 0.75),
        (0.0, 0.0, 0.0, 1.0),
    ],
)
def test_ratio_grows_linearly(initial, saturation, fraction, ratio):
    assert EncodingMask(initial=initial, saturation=saturation).ratio(fraction) == pytest.approx(
        ratio
    )


def seen(plugin: Regularizer, step, fraction: float) -> tuple[float | None, float | None]:
    samples = Hooks({"encoding_mask": plugin}).encoder_input(SAMPLES, step(fraction=fraction))
    assert samples.positions is POSITIONS
    return samples.density_features, samples.color_features


def test_encoder_input(step):
    # Half way: 16 of 32 grid features, 8 of 16 direction features.
    both = [MaskedNetwork.density, MaskedNetwork.color]
    assert seen(EncodingMask(initial=0.0, saturation=1.0), step, 0.5) == (16, None)
    assert seen(
        EncodingMask(initial=0.0, saturation=1.0, networks=[MaskedNetwork.color]), step, 0.5
    ) == (
        None,
        8,
    )
    assert seen(EncodingMask(initial=0.0, saturation=1.0, networks=both), step, 0.51) == (16, 8)
    plugin = EncodingMask(initial=0.0, saturation=1.0, networks=both, fractional=True)
    assert seen(plugin, step, 0.51) == pytest.approx((16.32, 8.16))


def test_a_quarter_is_there_from_the_start(step):
    # by default 32 / 4 grid features, and half way to saturation (1/4 + 1) / 2 = 5/8 of them, 20
    assert seen(EncodingMask(saturation=1.0), step, 0.0) == (8, None)
    assert seen(EncodingMask(saturation=1.0), step, 0.5) == (20, None)


def test_nothing_is_masked_once_saturated_or_outside_the_window(step):
    assert seen(EncodingMask(saturation=0.5), step, 0.5) == (None, None)
    assert seen(EncodingMask(saturation=0.9, end=0.3), step, 0.3) == (None, None)
    assert SAMPLES.density_features is None


def test_saturation_by_layout():
    # DESIGN: 90 % for LLFF, 20 % for NeRF-Synthetic.
    assert EncodingMask.by_layout == {"forward": {"saturation": 0.9}, "orbit": {"saturation": 0.2}}
