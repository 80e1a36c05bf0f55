from __future__ import annotations

import math

import mpmath
import pytest
import torch
from nerfreg_plugins.entropy import RayEntropy, entropy_loss

from nerfreg import Needs


def test_by_hand(dtype):
    # q = (1/2, 1/4, 1/4): 1/2 log 2 + 2 * 1/4 log 4 = 3/2 log 2. q = (1, 0, 0): 0. Mean of both.
    alphas = torch.tensor([[0.8, 0.4, 0.4], [0.3, 0.0, 0.0]], dtype=dtype)
    assert entropy_loss(alphas, 0.1).item() == pytest.approx(0.75 * math.log(2), rel=1e-6)


def test_a_uniform_ray_has_the_largest_entropy(dtype):
    assert entropy_loss(torch.full((2, 64), 0.5, dtype=dtype), 0.1).item() == pytest.approx(
        math.log(64), rel=1e-6
    )


def test_rays_up_to_the_threshold_are_0_and_still_count(dtype, finite_gradients):
    alphas = torch.tensor([[0.5, 0.5], [0.25, 0.25]], dtype=dtype, requires_grad=True)
    value = entropy_loss(alphas, 0.5)
    assert value.item() == pytest.approx(math.log(2) / 2, rel=1e-6)
    assert (finite_gradients(value, alphas)[0][1] == 0).all()


@pytest.mark.parametrize("small", [0.0, 1e-45, 1e-38, 1e-20])
@pytest.mark.parametrize("threshold", [0.0, 0.1])
def test_samples_of_almost_nothing(dtype, finite_gradients, small, threshold):
    alphas = torch.tensor([[1.0, small], [small, small]], dtype=dtype, requires_grad=True)
    value = entropy_loss(alphas, threshold)
    # The second ray is empty at any threshold; -q log q of the first is below 1e-18.
    assert value.item() == pytest.approx(0, abs=1e-18)
    finite_gradients(value, alphas)


@pytest.mark.parametrize("small", [1e-30, 1e-12, 1e-8, 1e-3])
def test_one_sample_with_nearly_everything(dtype, small):
    # q of the first sample is 1 to all digits, yet -q log q = 3 small, beside -3 q log q of the
    # other three.
    alphas = torch.tensor([[1.0, small, small, small]], dtype=dtype)
    with mpmath.workdps(50):
        exact = [mpmath.mpf(x) / mpmath.fsum(alphas[0].tolist()) for x in alphas[0].tolist()]
        expected = -mpmath.fsum(q * mpmath.log(q) for q in exact)
    assert entropy_loss(alphas, 0.1).item() == pytest.approx(
        float(expected), rel=1e-6 if dtype == torch.float32 else 1e-14
    )


def test_a_sample_of_nothing_would_raise_the_entropy(dtype, finite_gradients):
    # dH / dalpha_i = (-log q_i - H) / sum alpha: infinite at 0, here with q_i of the smallest
    # normal number.
    alphas = torch.tensor([[0.5, 0.5, 0.0]], dtype=dtype, requires_grad=True)
    [grad] = finite_gradients(entropy_loss(alphas, 0.1), alphas)
    assert grad[0].tolist() == pytest.approx(
        [0, 0, -math.log(torch.finfo(dtype).tiny) - math.log(2)], rel=1e-6, abs=1e-6
    )


@pytest.mark.parametrize("half", [torch.bfloat16, torch.float16])
def test_half_precision_is_computed_in_float32(half):
    alphas = torch.rand(3, 5, generator=torch.Generator().manual_seed(1)).to(half)
    assert torch.equal(entropy_loss(alphas, 0.1), entropy_loss(alphas.float(), 0.1))


def test_gradcheck():
    alphas = torch.rand(
        3, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0)
    ).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: entropy_loss(x, 0.1), alphas)


def test_doubling_the_batch_changes_nothing():
    alphas = torch.rand(3, 5, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(
        entropy_loss(torch.cat([alphas, alphas]), 0.1), entropy_loss(alphas, 0.1)
    )


def test_loss(rendering, dtype, finite_gradients):
    # Alphas (1/2, 1/2): log 2. The empty ray gives 0, and so does one that is opaque at once.
    half = math.log(2)
    tau = torch.tensor([[half, half], [0.0, 0.0], [1e30, 0.0]], dtype=dtype, requires_grad=True)
    term = RayEntropy().nerfreg_loss(rendering(tau))["entropy"]
    assert term.item() == pytest.approx(math.log(2) / 3, rel=1e-6)
    finite_gradients(term, tau)


def test_needs():
    assert RayEntropy(unseen_rays=0.5).nerfreg_needs() == Needs(unseen_rays=0.5)
