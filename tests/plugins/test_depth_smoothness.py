from __future__ import annotations

import pytest
import torch
from nerfreg_plugins.depth_smoothness import DepthSmoothness, Reduction, depth_smoothness_loss

from nerfreg import Needs


def test_by_hand(dtype):
    # i = j = 1 only: (1 - 4)^2 down, (1 - 3)^2 right. The last row and column start no term.
    patch = torch.tensor([[[1.0, 3.0], [4.0, 100.0]]], dtype=dtype)
    assert depth_smoothness_loss(patch) == 13
    # A slope of 1 down and 2 right on 4 x 4: nine pixels with 1 + 4 each.
    slope = torch.arange(4.0, dtype=dtype)[:, None] + 2 * torch.arange(4.0, dtype=dtype)
    assert depth_smoothness_loss(slope[None]) == 45


def test_mean_over_patches(dtype):
    patches = torch.tensor([[[1.0, 3.0], [4.0, 0.0]], [[5.0, 5.0], [5.0, 5.0]]], dtype=dtype)
    assert depth_smoothness_loss(patches) == 6.5
    assert depth_smoothness_loss(torch.cat([patches, patches])) == 6.5


@pytest.mark.parametrize("missing", [6.0, float("inf"), float("nan")])
def test_terms_with_an_invisible_pixel_are_left_out(dtype, finite_gradients, missing):
    # On a flat 3 x 3 patch with one step at the right: (0,1)-(0,2) and (1,1)-(1,2) are 1 each;
    # (0,2) is missing.
    patch = torch.tensor(
        [[[0.0, 0.0, missing], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]], dtype=dtype, requires_grad=True
    )
    visible = torch.ones(1, 3, 3, dtype=torch.bool)
    visible[0, 0, 2] = False
    value = depth_smoothness_loss(patch, visible)
    assert value == 1
    # d/d(1,1) of (d11 - d12)^2 = -2, d/d(1,2) = 2, nothing elsewhere.
    expected = torch.zeros(1, 3, 3, dtype=dtype)
    expected[0, 1, 1:] = torch.tensor([-2.0, 2.0])
    torch.testing.assert_close(finite_gradients(value, patch)[0], expected)


def test_nothing_visible(dtype, finite_gradients):
    patch = torch.full((2, 3, 3), float("inf"), dtype=dtype, requires_grad=True)
    value = depth_smoothness_loss(patch, torch.zeros(2, 3, 3, dtype=torch.bool))
    assert value == 0
    assert (finite_gradients(value, patch)[0] == 0).all()


@pytest.mark.parametrize("shape", [(0, 4, 4), (3, 1, 1)])
def test_nothing_to_compare(dtype, finite_gradients, shape):
    patch = torch.ones(shape, dtype=dtype, requires_grad=True)
    value = depth_smoothness_loss(patch)
    assert value == 0
    finite_gradients(value, patch)


@pytest.mark.parametrize("half", [torch.bfloat16, torch.float16])
def test_half_precision_is_computed_in_float32(half):
    patch = torch.rand(2, 4, 4, generator=torch.Generator().manual_seed(0)).to(half)
    assert torch.equal(depth_smoothness_loss(patch), depth_smoothness_loss(patch.float()))


def test_far_away_small_differences_keep_their_digits(rendering, step, dtype):
    # Opaque at once, at 4 + 2^-20 or 4: normalised before the difference is taken, 2^-20 / 4 would
    # lose 3 digits.
    tau = torch.full((4, 1), 50.0, dtype=dtype)
    far = torch.tensor([2, 0, 0, 0], dtype=dtype) * 2.0**-20
    edges = torch.stack([torch.full((4,), 2.0, dtype=dtype), 6 + far], dim=1)
    made = rendering(tau, edges, patches=torch.tensor([[[0, 1], [2, 3]]]))
    made.depth = 4 + far / 2
    term = DepthSmoothness().nerfreg_loss(made, step())["depth_smoothness"]
    assert term.item() == pytest.approx(2 * (2.0**-20 / 4) ** 2, rel=1e-6)


def test_gradcheck():
    patch = torch.rand(
        2, 4, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0)
    ).requires_grad_()
    assert torch.autograd.gradcheck(depth_smoothness_loss, patch)


def patch_of_four(rendering, dtype=torch.float64):
    # One patch of 2 x 2. Bounds are 2 and 6; two samples with midpoints 3 and 5, at 1/4 and 3/4 of
    # them. Ray 0 has weights (1/2, 0), ray 1 (0, 1/2), ray 2 (1/2, 1/4), ray 3 is not used.
    half = 0.6931471805599453
    tau = torch.tensor([[half, 0.0], [0.0, half], [half, half], [0.0, 0.0]], dtype=dtype)
    return rendering(tau.requires_grad_(), patches=torch.tensor([[[0, 1], [2, 3]]]))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        # Depths 1/4, 3/4 and (1/2 * 1/4 + 1/4 * 3/4) / (3/4) = 5/12: (1/2)^2 + (1/6)^2.
        ({}, 1 / 4 + 1 / 36),
        # One pixel starts terms, so its mean is the sum; opacity of ray 0 is 1/2.
        ({"reduction": Reduction.mean}, 1 / 4 + 1 / 36),
        ({"opacity_weighted": True}, (1 / 4 + 1 / 36) / 2),
    ],
)
def test_loss(rendering, step, finite_gradients, options, expected):
    made = patch_of_four(rendering)
    term = DepthSmoothness(**options).nerfreg_loss(made, step())["depth_smoothness"]
    assert term.item() == pytest.approx(expected)
    finite_gradients(term, made.tau)


def test_opacity_as_a_factor_has_a_gradient(rendering, step):
    # More in the only interval of ray 0 that holds anything leaves its depth as it is, and adds
    # exp(-tau) = 1/2 to its opacity.
    made = patch_of_four(rendering)
    term = DepthSmoothness(opacity_weighted=True).nerfreg_loss(made, step())["depth_smoothness"]
    [gradient] = torch.autograd.grad(term, made.tau)
    assert gradient[0, 0].item() == pytest.approx((1 / 4 + 1 / 36) / 2)


def test_mean_divides_by_the_pixels_that_start_terms(rendering, step):
    tau = torch.rand(16, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    made = rendering(tau, patches=torch.arange(16).reshape(1, 4, 4))
    total, mean = (
        DepthSmoothness(reduction=r).nerfreg_loss(made, step())["depth_smoothness"]
        for r in (Reduction.sum, Reduction.mean)
    )
    torch.testing.assert_close(mean * 9, total)


def test_empty_rays_have_no_part(rendering, step, dtype, finite_gradients):
    # Ray 1 is empty, ray 2 all but: only pixel 0 is left, and it has nobody to differ from.
    tau = torch.tensor(
        [[1.0, 1.0], [0.0, 0.0], [0.0, 9e-5], [1.0, 2.0]], dtype=dtype, requires_grad=True
    )
    made = rendering(tau, patches=torch.tensor([[[0, 1], [2, 3]]]))
    term = DepthSmoothness().nerfreg_loss(made, step())["depth_smoothness"]
    assert term == 0
    assert (finite_gradients(term, tau)[0] == 0).all()


def test_without_patches_there_is_no_term(rendering, step):
    assert DepthSmoothness().nerfreg_loss(rendering(torch.ones(2, 2)), step()) == {}


def test_needs():
    assert DepthSmoothness().nerfreg_needs() == Needs(patch_size=4, patch_fraction=0.0625)
