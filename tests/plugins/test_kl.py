from __future__ import annotations

import math

import mpmath
import pytest
import torch
from nerfreg_plugins.kl import Density, KLDirection, KLDivergence, Neighbors, kl_loss_of_logs

from nerfreg import Needs


def test_by_hand(dtype):
    # p = (1/2, 1/2, 0), q = (1/4, 1/2, 1/4): 1/2 log 2 + 1/2 log 1 + 0.
    p = torch.tensor([[2.0, 2.0, 0.0]], dtype=dtype).log()
    q = torch.tensor([[1.0, 2.0, 1.0]], dtype=dtype).log()
    assert kl_loss_of_logs(p, q).item() == pytest.approx(0.5 * math.log(2), rel=1e-6)


def test_the_neighbour_is_floored_at_1e_10(dtype):
    # All of p lies where q has nothing: log(1 / 1e-10) and no more.
    p = torch.tensor([[1.0, 0.0]], dtype=dtype).log()
    q = torch.tensor([[0.0, 1.0]], dtype=dtype).log()
    assert kl_loss_of_logs(p, q).item() == pytest.approx(10 * math.log(10), rel=1e-6)


def test_weights_that_underflow_have_a_true_divergence(dtype, finite_gradients):
    # Log-weights near -1000, whose weights are 0 even in float64; 50 digits say what their ratio
    # means.
    raw_p, raw_q = [-1000.0, -1001.5, -1003.0], [-2000.25, -2000.0, -2004.0]
    mpmath.mp.dps = 50
    p, q = ([mpmath.exp(x) for x in raw] for raw in (raw_p, raw_q))
    expected = sum(
        a / sum(p) * mpmath.log(a / sum(p) / (b / sum(q))) for a, b in zip(p, q, strict=True)
    )
    ray = torch.tensor([raw_p], dtype=dtype, requires_grad=True)
    neighbor = torch.tensor([raw_q], dtype=dtype, requires_grad=True)
    value = kl_loss_of_logs(ray, neighbor)
    assert value.item() == pytest.approx(
        float(expected), rel=1e-6 if dtype == torch.float32 else 1e-11
    )
    finite_gradients(value, ray, neighbor)


@pytest.mark.parametrize("empty", ["ray", "neighbor", "both"])
def test_a_pair_with_an_empty_ray_is_0_and_still_counts(dtype, finite_gradients, empty):
    ray = torch.tensor([[0.5, 0.5], [0.5, 0.5]], dtype=dtype).log()
    neighbor = torch.tensor([[0.25, 0.75], [0.25, 0.75]], dtype=dtype).log()
    whole = kl_loss_of_logs(ray, neighbor)
    if empty in ("ray", "both"):
        ray[1] = -math.inf
    if empty in ("neighbor", "both"):
        neighbor[1] = -math.inf
    ray.requires_grad_(), neighbor.requires_grad_()
    value = kl_loss_of_logs(ray, neighbor)
    assert value.item() == pytest.approx(whole.item() / 2, rel=1e-6)
    for grad in finite_gradients(value, ray, neighbor):
        assert (grad[1] == 0).all()
        assert (grad[0] != 0).all()


@pytest.mark.parametrize("offset", [0.0, -3.0, -100.0])
@pytest.mark.parametrize("apart", [1e-1, 1e-4, 1e-6])
def test_neighbours_that_nearly_agree_keep_their_digits(dtype, finite_gradients, apart, offset):
    # D is about the variance of the difference, down to 1e-13, between logarithms of up to 100. A
    # common factor of the neighbour's weights (the offset) is rounded together with them, so
    # float64 knows their difference to 1e-14 only.
    generator = torch.Generator().manual_seed(0)
    ray = (-5 * torch.rand(1, 48, dtype=torch.float64, generator=generator)).to(dtype)
    neighbor = (
        ray.double() + offset + apart * torch.randn(1, 48, dtype=torch.float64, generator=generator)
    ).to(dtype)
    with mpmath.workdps(50):
        p, q = ([mpmath.exp(x) for x in log_weights[0].tolist()] for log_weights in (ray, neighbor))
        p, q = ([x / mpmath.fsum(values) for x in values] for values in (p, q))
        expected = mpmath.fsum(a * mpmath.log(a / b) for a, b in zip(p, q, strict=True))
    ray.requires_grad_(), neighbor.requires_grad_()
    value = kl_loss_of_logs(ray, neighbor)
    assert expected > 0
    exact = offset == 0 or dtype == torch.float32
    assert value.item() == pytest.approx(
        float(expected), rel=1e-11 if exact and dtype == torch.float64 else 1e-5
    )
    finite_gradients(value, ray, neighbor)


def test_equal_rays_have_no_divergence(dtype):
    ray = torch.randn(4, 48, dtype=dtype, generator=torch.Generator().manual_seed(0))
    assert kl_loss_of_logs(ray, ray) == 0


@pytest.mark.parametrize("half", [torch.bfloat16, torch.float16])
def test_half_precision_is_computed_in_float32(half):
    p, q = torch.randn(2, 3, 5, generator=torch.Generator().manual_seed(1)).to(half)
    assert torch.equal(kl_loss_of_logs(p, q), kl_loss_of_logs(p.float(), q.float()))


def test_no_pairs(dtype):
    assert kl_loss_of_logs(torch.zeros(0, 4, dtype=dtype), torch.zeros(0, 4, dtype=dtype)) == 0


@pytest.mark.parametrize("extreme", [-1e30, -3e38, -math.inf])
def test_extremely_dark_samples(dtype, finite_gradients, extreme):
    p = torch.tensor([[0.0, extreme], [extreme, 0.0]], dtype=dtype, requires_grad=True)
    q = torch.tensor([[extreme, 0.0], [extreme, 0.0]], dtype=dtype, requires_grad=True)
    value = kl_loss_of_logs(p, q)
    # The first pair is apart (10 log 10), the second equal (0).
    assert value.item() == pytest.approx(5 * math.log(10), rel=1e-6)
    finite_gradients(value, p, q)


def test_gradcheck():
    generator = torch.Generator().manual_seed(0)
    p, q = (
        torch.randn(3, 5, dtype=torch.float64, generator=generator).requires_grad_()
        for _ in range(2)
    )
    assert torch.autograd.gradcheck(kl_loss_of_logs, (p, q))


def test_doubling_the_batch_changes_nothing():
    p, q = torch.randn(2, 3, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(
        kl_loss_of_logs(p.repeat(2, 1), q.repeat(2, 1)), kl_loss_of_logs(p, q)
    )


def pair_of_rays(rendering, dtype=torch.float64):
    # Alphas (1/2, 1/2) against (1/2, 0): weights (1/2, 1/4) against (1/2, 0).
    tau = torch.tensor([[1.0, 1.0], [1.0, 0.0]], dtype=dtype) * math.log(2)
    return rendering(tau.requires_grad_(), neighbors=torch.tensor([[0, 1]]))


FLOOR = math.log(1e-10)


@pytest.mark.parametrize(
    ("density", "direction", "expected"),
    [
        # p = (2/3, 1/3), q = (1, 0)
        (
            Density.weights,
            KLDirection.forward,
            2 / 3 * math.log(2 / 3) + 1 / 3 * (math.log(1 / 3) - FLOOR),
        ),
        # p = (1, 0), q = (2/3, 1/3)
        (Density.weights, KLDirection.reverse, math.log(3 / 2)),
        # p = (1/2, 1/2), q = (1, 0)
        (Density.alphas, KLDirection.forward, math.log(1 / 2) - FLOOR / 2),
        (Density.alphas, KLDirection.reverse, math.log(2)),
    ],
)
def test_loss(rendering, step, finite_gradients, density, direction, expected):
    made = pair_of_rays(rendering)
    terms = KLDivergence(density=density, direction=direction).nerfreg_loss(made, step())
    assert terms["kl"].item() == pytest.approx(expected)
    finite_gradients(terms["kl"], made.tau)


def test_an_invisible_neighbour_makes_the_pair_0(rendering, step, dtype, finite_gradients):
    # Opacity 2e-5 is below 1e-4, though the distribution along the ray would be well defined.
    tau = torch.tensor([[1.0, 2.0], [1e-5, 1e-5], [0.0, 0.0]], dtype=dtype, requires_grad=True)
    made = rendering(tau, neighbors=torch.tensor([[0, 1], [1, 0], [0, 2]]))
    for density in Density:
        term = KLDivergence(density=density).nerfreg_loss(made, step())["kl"]
        assert term == 0
        assert (finite_gradients(term, tau)[0] == 0).all()


def test_stiff_rays(rendering, step, dtype, finite_gradients):
    tau = torch.tensor([[1e30, 1.0, 0.0], [0.0, 1e-30, 1e8]], dtype=dtype, requires_grad=True)
    made = rendering(tau, neighbors=torch.tensor([[0, 1], [1, 0]]))
    for density in Density:
        finite_gradients(KLDivergence(density=density).nerfreg_loss(made, step())["kl"], tau)


def test_without_neighbours_there_is_no_term(rendering, step):
    assert KLDivergence().nerfreg_loss(rendering(torch.ones(2, 2)), step()) == {}


def test_needs():
    assert KLDivergence().nerfreg_needs() == Needs(
        patch_size=2, patch_fraction=0.0625, neighbors="patch"
    )
    assert KLDivergence(neighbors=Neighbors.extra).nerfreg_needs() == Needs(neighbors="extra")
