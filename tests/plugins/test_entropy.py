from __future__ import annotations

import math

import pytest
import torch
from nerfreg_plugins.entropy import RayEntropy, ray_entropy

from nerfreg import Needs


def test_by_hand(dtype):
    # q = (1/2, 1/4, 1/4): 1/2 log 2 + 2 * 1/4 log 4 = 3/2 log 2. q = (1, 0, 0): 0. Mean of both.
    alphas = torch.tensor([[0.8, 0.4, 0.4], [0.3, 0.0, 0.0]], dtype=dtype)
    assert ray_entropy(alphas, 0.1).item() == pytest.approx(0.75 * math.log(2), rel=1e-6)


def test_a_uniform_ray_has_the_largest_entropy(dtype):
    assert ray_entropy(torch.full((2, 64), 0.5, dtype=dtype), 0.1).item() == pytest.approx(math.log(64), rel=1e-6)


def test_rays_up_to_the_threshold_are_0_and_still_count(dtype, finite_gradients):
    alphas = torch.tensor([[0.5, 0.5], [0.25, 0.25]], dtype=dtype, requires_grad=True)
    value = ray_entropy(alphas, 0.5)
    assert value.item() == pytest.approx(math.log(2) / 2, rel=1e-6)
    assert (finite_gradients(value, alphas)[0][1] == 0).all()


@pytest.mark.parametrize("small", [0.0, 1e-45, 1e-38, 1e-20])
@pytest.mark.parametrize("threshold", [0.0, 0.1])
def test_samples_of_almost_nothing(dtype, finite_gradients, small, threshold):
    alphas = torch.tensor([[1.0, small], [small, small]], dtype=dtype, requires_grad=True)
    value = ray_entropy(alphas, threshold)
    # The second ray is empty at any threshold; -q log q of the first is below 1e-18.
    assert value.item() == pytest.approx(0, abs=1e-18)
    finite_gradients(value, alphas)


def test_gradcheck():
    alphas = torch.rand(3, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: ray_entropy(x, 0.1), alphas)


def test_doubling_the_batch_changes_nothing():
    alphas = torch.rand(3, 5, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(ray_entropy(torch.cat([alphas, alphas]), 0.1), ray_entropy(alphas, 0.1))


def test_loss(rendering, dtype, finite_gradients):
    # Alphas (1/2, 1/2): log 2. The empty ray gives 0, and so does one that is opaque at once.
    half = math.log(2)
    tau = torch.tensor([[half, half], [0.0, 0.0], [1e30, 0.0]], dtype=dtype, requires_grad=True)
    term = RayEntropy().nerfreg_loss(rendering(tau))["entropy"]
    assert term.item() == pytest.approx(math.log(2) / 3, rel=1e-6)
    finite_gradients(term, tau)


def test_needs():
    assert RayEntropy(unseen_rays=0.5).nerfreg_needs() == Needs(unseen_rays=0.5)
