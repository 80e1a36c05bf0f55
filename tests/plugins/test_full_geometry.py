from __future__ import annotations

import math

import pytest
import torch
from nerfreg_plugins.full_geometry import (
    FullGeometry,
    full_geometry_loss,
    full_geometry_loss_of_thickness,
)

from nerfreg import Needs


def test_by_hand(dtype):
    # (1 - 3/4)^2 = 1/16, (1 - 1)^2 = 0, (1 - 0)^2 = 1.
    weights = torch.tensor([[0.5, 0.25], [0.5, 0.5], [0.0, 0.0]], dtype=dtype)
    assert full_geometry_loss(weights).item() == pytest.approx((1 / 16 + 0 + 1) / 3)


def test_equals_that_of_thickness_forward_and_backward():
    tau = torch.rand(
        4, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0)
    ).requires_grad_()
    weights = (tau - tau.cumsum(-1)).exp() * -torch.expm1(-tau)
    a, b = full_geometry_loss(weights), full_geometry_loss_of_thickness(tau)
    torch.testing.assert_close(a, b)
    torch.testing.assert_close(torch.autograd.grad(a, tau), torch.autograd.grad(b, tau))


def test_opaque_rays_keep_their_digits(dtype, finite_gradients):
    # Transmittance exp(-20), below the spacing of float32 at 1: the gradient is -2 exp(-40), not 0.
    tau = torch.tensor([[12.0, 8.0]], dtype=dtype, requires_grad=True)
    value = full_geometry_loss_of_thickness(tau)
    assert value.item() == pytest.approx(math.exp(-40), rel=1e-5)
    assert finite_gradients(value, tau)[0].tolist() == [
        pytest.approx([-2 * math.exp(-40)] * 2, rel=1e-5)
    ]


@pytest.mark.parametrize("tau", [0.0, 1e-30, 1e8, 1e38])
def test_extremes(dtype, finite_gradients, tau):
    thickness = torch.full((2, 3), tau, dtype=dtype, requires_grad=True)
    value = full_geometry_loss_of_thickness(thickness)
    assert value.item() == pytest.approx(math.exp(-6 * tau))
    finite_gradients(value, thickness)


@pytest.mark.parametrize("missing", [1e-3, 1e-7, 1e-15, 1e-18])
def test_weights_that_sum_to_nearly_one(dtype, finite_gradients, missing):
    # 1 - (1 + missing): float32 cannot even hold that sum; what is left over must still be right.
    weights = torch.tensor([[0.5, 0.25, missing, 0.25]], dtype=dtype, requires_grad=True)
    given = weights[0, 2].item()
    value = full_geometry_loss(weights)
    assert value.item() == pytest.approx(given**2, rel=1e-6 if dtype == torch.float32 else 1e-14)
    assert finite_gradients(value, weights)[0].tolist() == [pytest.approx([2 * given] * 4)]


@pytest.mark.parametrize("half", [torch.bfloat16, torch.float16])
def test_half_precision_is_computed_in_float32(half):
    x = torch.rand(3, 5, generator=torch.Generator().manual_seed(1)).to(half)
    for loss in (full_geometry_loss, full_geometry_loss_of_thickness):
        assert torch.equal(loss(x), loss(x.float()))


def test_gradcheck():
    x = torch.rand(
        3, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0)
    ).requires_grad_()
    assert torch.autograd.gradcheck(full_geometry_loss, x)
    assert torch.autograd.gradcheck(full_geometry_loss_of_thickness, x)


def test_doubling_the_batch_changes_nothing():
    x = torch.rand(3, 4, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(full_geometry_loss(torch.cat([x, x])), full_geometry_loss(x))


def test_loss(rendering):
    # Half the light passes the first ray, none is stopped in the second: (1/4 + 1) / 2.
    tau = torch.tensor([[math.log(2), 0.0], [0.0, 0.0]])
    assert FullGeometry().nerfreg_loss(rendering(tau))["full_geometry"].item() == pytest.approx(
        0.625
    )


def test_needs():
    assert FullGeometry().nerfreg_needs() is None
    assert FullGeometry(patch_size=4).nerfreg_needs() == Needs(patch_size=4, patch_fraction=0.0625)
