from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from nerfreg_plugins.stereo import Stereo, stereo_loss

from nerfreg import NerfregError

NOTHING = [math.nan, math.nan]


def loss(tau: torch.Tensor, edges: torch.Tensor, known: torch.Tensor, doubt: float) -> torch.Tensor:
    """Of the weights that optical thickness makes."""
    before = torch.cat([torch.zeros_like(tau[:, :1]), tau[:, :-1].cumsum(-1)], dim=1)
    return stereo_loss(torch.exp(-before) * -torch.expm1(-tau), edges, known, doubt, tau)


def test_by_hand(dtype, finite_gradients):
    # Half of what is left stays in each: weights 1/2, 1/4, 1/8, 1/16. Between 1.5 and 2.5 are the
    # second and the third; the others are half an extent away from there, once, and count half:
    # m = 1/4 + 1/4 + 1/8 + 1/32.
    tau = torch.full((1, 4), math.log(2), dtype=dtype, requires_grad=True)
    edges = torch.arange(5, dtype=dtype)[None]
    value = loss(tau, edges, torch.tensor([[1.5, 2.5]], dtype=dtype), doubt=0.1)
    assert value.item() == pytest.approx(math.log(1.1 / 0.75625))
    # By tau_j m changes by what counts of the light behind j, less what counts of the weights
    # there.
    changes = torch.tensor([1 / 4 - 13 / 32, 1 / 4 - 5 / 32, 1 / 8 - 1 / 32, 1 / 32])
    gradient = finite_gradients(value, tau)[0]
    assert gradient[0].tolist() == pytest.approx((-changes / 0.75625).tolist(), abs=1e-6)


def test_the_further_away_the_less_a_weight_counts():
    tau = torch.tensor([[1000.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
    edges = torch.tensor([[0.0, 1.0, 2.0, 9.0, 10.0]], dtype=torch.float64)
    # 1, 3 and 7 times half the extent from where the weight ends.
    for first, x in ((2.0, 1), (4.0, 3), (8.0, 7)):
        value = loss(tau, edges, torch.tensor([[first, first + 2]], dtype=torch.float64), doubt=0.1)
        assert value.item() == pytest.approx(math.log(1.1 / (1 / (1 + x**2) + 0.1)))


def test_a_depth_that_is_known_exactly(finite_gradients):
    tau = torch.tensor([[math.log(2), 1000.0]], requires_grad=True)
    value = loss(tau, torch.tensor([[0.0, 1.0, 2.0]]), torch.tensor([[1.5, 1.5]]), doubt=0.1)
    assert value.item() == pytest.approx(math.log(1.1 / 0.6))
    finite_gradients(value, tau)


def test_all_weight_there_is_no_loss(finite_gradients):
    tau = torch.tensor([[0.0, 1000.0]], requires_grad=True)
    value = loss(tau, torch.tensor([[0.0, 1.0, 2.0]]), torch.tensor([[1.2, 1.3]]), doubt=0.1)
    assert value == 0
    finite_gradients(value, tau)


def test_nearly_all_weight_there_keeps_its_digits(dtype):
    # A haze of 1e-9 before the wall, 4 times half the extent away, and exp(-25) behind it; together
    # far below what 1 - m could tell in float32.
    tau = torch.tensor([[1e-9, 25.0]], dtype=dtype)
    value = loss(
        tau, torch.tensor([[0.0, 1.0, 2.0]], dtype=dtype), torch.tensor([[1.2, 1.3]]), doubt=0.1
    )
    assert value.item() == pytest.approx((1e-9 * 16 / 17 + math.exp(-25)) / 1.1, rel=1e-6)


def test_no_weight_there_costs_the_doubt(finite_gradients):
    tau = torch.tensor([[1000.0, 0.0]], requires_grad=True)
    for doubt in (0.1, 1e-6):
        value = loss(tau, torch.tensor([[0.0, 1.0, 1e9]]), torch.tensor([[1e8, 1e8 + 8]]), doubt)
        assert value.item() == pytest.approx(math.log((1 + doubt) / doubt), rel=1e-6)
        finite_gradients(value, tau)


@pytest.mark.parametrize("known", [NOTHING, [5.0, 6.0], [-2.0, -1.0]])
def test_rays_without_a_depth_count_as_kept(dtype, finite_gradients, known):
    tau = torch.tensor([[math.log(2), 1000.0]] * 2, dtype=dtype, requires_grad=True)
    edges = torch.tensor([[0.0, 1.0, 2.0]], dtype=dtype).expand(2, 3)
    value = loss(tau, edges, torch.tensor([known, [1.5, 2.0]], dtype=dtype), doubt=0.5)
    # One ray of two, half of whose weight is twice half the extent away: log(1.5 / 1.1) / 2
    assert value.item() == pytest.approx(math.log(1.5 / 1.1) / 2)
    assert (finite_gradients(value, tau)[0][0] == 0).all()


def test_no_rays():
    assert loss(torch.ones(0, 4), torch.ones(0, 5), torch.ones(0, 2), doubt=0.1) == 0


def test_gradcheck():
    generator = torch.Generator().manual_seed(0)
    tau = torch.rand(3, 4, dtype=torch.float64, generator=generator)
    edges = torch.linspace(1, 5, 5, dtype=torch.float64).expand(3, 5)
    known = torch.tensor([[1.5, 1.75], [2.5, 4.5], NOTHING], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda tau: loss(tau, edges, known, 0.1), tau.requires_grad_())


def test_only_rays_with_a_photograph_count(rendering):
    plugin = Stereo()
    made = rendering(torch.full((4, 2), 0.5), targets=torch.zeros(3, 3))
    assert plugin.nerfreg_loss(made) == {}
    # Edges 2, 4, 6; a weight of 1 - exp(-0.5) in the first interval. The fourth ray has no target.
    made = replace(
        made, rays=replace(made.rays, known_depth=torch.tensor([[2.5, 3.0], NOTHING, NOTHING]))
    )
    # The second is from 3.0 on 1 away, 4 times half the extent.
    first = 1 - math.exp(-0.5)
    there = first + math.exp(-0.5) * first / 17
    assert plugin.nerfreg_loss(made)["stereo"].item() == pytest.approx(
        math.log(1.1 / (there + 0.1)) / 3
    )


@pytest.mark.parametrize(
    "wrong", [{"doubt": 0.0}, {"width": 0}, {"window": 4}, {"sources": 0}, {"tolerance": 0.0}]
)
def test_searches_that_cannot_be(wrong):
    [(key, value)] = wrong.items()
    with pytest.raises(NerfregError, match=rf"reg.stereo.{key}={value}: must be"):
        Stereo(**wrong)
