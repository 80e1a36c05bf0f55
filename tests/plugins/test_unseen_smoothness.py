from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from nerfreg_plugins.unseen_smoothness import UnseenSmoothness, unseen_smoothness_loss


def all_of(patches):
    return torch.ones(patches.shape, dtype=torch.bool)


def test_by_hand(dtype, finite_gradients):
    # 1 2 / 2 8: right log 2 and log 4, down log 2 and log 4; squares (1 + 4 + 1 + 4) log(2)^2. The
    # flat patch adds 0.
    depth = torch.tensor(
        [[[1.0, 2.0], [2.0, 8.0]], [[3.0, 3.0], [3.0, 3.0]]], dtype=dtype, requires_grad=True
    )
    value = unseen_smoothness_loss(depth, all_of(depth))
    assert value.item() == pytest.approx(10 * math.log(2) ** 2 / 2)
    # d/dlog of the 8: twice log 4, times 2 for the square, over 2 patches; and 1/8 for d log d.
    gradient = finite_gradients(value, depth)[0]
    assert gradient[0, 1, 1].item() == pytest.approx(2 * math.log(4) * 2 / 2 / 8)
    assert (gradient[1] == 0).all()


def test_units_do_not_matter(dtype):
    depth = torch.rand(2, 4, 4, dtype=dtype, generator=torch.Generator().manual_seed(0)) + 1
    for factor in (1e-6, 1e6):
        assert unseen_smoothness_loss(depth * factor, all_of(depth)).item() == pytest.approx(
            unseen_smoothness_loss(depth, all_of(depth)).item(), rel=1e-5
        )


def test_nearly_equal_depths_keep_their_digits():
    # One step of float32 at 10000: log(1 + 2^-10 / 10000), which the difference of two rounded
    # logarithms loses.
    step = 2.0**-10
    depth = torch.tensor([[[1e4, 1e4 + step], [1e4, 1e4 + step]]])
    expected = 2 * math.log1p(step / 1e4) ** 2
    assert unseen_smoothness_loss(depth, all_of(depth)).item() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("empty", [0.0, float("inf"), 1e30])
def test_empty_rays_are_left_out(dtype, finite_gradients, empty):
    depth = torch.tensor([[[1.0, 2.0], [empty, 2.0]]], dtype=dtype, requires_grad=True)
    visible = torch.tensor([[[True, True], [False, True]]])
    value = unseen_smoothness_loss(depth, visible)
    assert value.item() == pytest.approx(math.log(2) ** 2)
    assert finite_gradients(value, depth)[0][0, 1, 0] == 0


def test_depths_of_zero_are_left_out(finite_gradients):
    depth = torch.tensor([[[0.0, 1.0], [0.0, 1.0]]], requires_grad=True)
    value = unseen_smoothness_loss(depth, all_of(depth))
    assert value == 0
    finite_gradients(value, depth)


def test_no_patch_and_patches_of_one_pixel():
    assert unseen_smoothness_loss(torch.ones(0, 4, 4), torch.ones(0, 4, 4, dtype=torch.bool)) == 0
    assert unseen_smoothness_loss(torch.ones(3, 1, 1), torch.ones(3, 1, 1, dtype=torch.bool)) == 0


def test_gradcheck():
    depth = (
        torch.rand(2, 3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) + 0.5
    )
    assert torch.autograd.gradcheck(
        lambda d: unseen_smoothness_loss(d, all_of(d)), depth.requires_grad_()
    )


def test_only_unseen_patches_count(rendering):
    plugin = UnseenSmoothness()
    made = rendering(torch.ones(4, 2))
    assert plugin.nerfreg_loss(made) == {}
    squares = torch.arange(4).view(1, 2, 2)
    made = replace(
        made,
        depth=torch.tensor([1.0, 2.0, 2.0, 8.0]),
        rays=replace(made.rays, unseen_patches=squares),
    )
    assert plugin.nerfreg_loss(made)["unseen_smoothness"].item() == pytest.approx(
        10 * math.log(2) ** 2
    )
    needs = plugin.nerfreg_needs()
    assert (needs.patch_size, needs.unseen_patches, needs.patch_fraction) == (8, 0.125, 0.0)
