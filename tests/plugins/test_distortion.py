from __future__ import annotations

from itertools import pairwise

import mpmath
import pytest
import torch
from nerfreg_plugins.distortion import Distortion, distortion_loss


def all_pairs(weights, t_edges, depth):
    """The definition, literally, in O(N^2)."""
    middle = (t_edges[:, 1:] + t_edges[:, :-1]) / 2
    pairs = (
        weights[:, :, None] * weights[:, None, :] * (middle[:, :, None] - middle[:, None, :]).abs()
    )
    own = weights.square() * t_edges.diff(dim=-1) / 3
    return ((pairs.sum((1, 2)) + own.sum(1)) / depth).mean()


def random_rays(count=4, samples=7):
    generator = torch.Generator().manual_seed(0)
    t_edges = (
        torch.rand(count, samples + 1, dtype=torch.float64, generator=generator).sort(-1).values + 1
    )
    weights = torch.rand(count, samples, dtype=torch.float64, generator=generator)
    return weights / (weights.sum(-1, keepdim=True) + 1), t_edges, t_edges[:, 3].clone()


def test_by_hand(dtype):
    # Edges 0 1 3, midpoints 1/2 and 2, depth 2:
    # (2 * 1/2 * 1/4 * 3/2 + (1/4 * 1 + 1/16 * 2) / 3) / 2.
    weights = torch.tensor([[0.5, 0.25]], dtype=dtype)
    t_edges = torch.tensor([[0.0, 1.0, 3.0]], dtype=dtype)
    assert distortion_loss(
        weights, t_edges, torch.tensor([2.0], dtype=dtype)
    ).item() == pytest.approx(0.25)


def test_equals_all_pairs_forward_and_backward():
    rays = [tensor.requires_grad_() for tensor in random_rays()]
    fast, plain = distortion_loss(*rays), all_pairs(*rays)
    torch.testing.assert_close(fast, plain)
    torch.testing.assert_close(torch.autograd.grad(fast, rays), torch.autograd.grad(plain, rays))


def test_float32_keeps_its_digits_between_10000_and_10001():
    # There float32 has steps of 1/1024, so midpoints would round; the edges themselves are taken as
    # given.
    weights = torch.rand(1, 64, generator=torch.Generator().manual_seed(0)) / 64
    t_edges = (
        10000
        + torch.randperm(1024, generator=torch.Generator().manual_seed(1))[:65].sort().values[None]
        / 1024
    )
    depth = torch.tensor([10000.5])
    mpmath.mp.dps = 40
    w, t = ([mpmath.mpf(x) for x in row[0].tolist()] for row in (weights, t_edges))
    m = [(a + b) / 2 for a, b in pairwise(t)]
    expected = sum(
        a * b * abs(x - y) for a, x in zip(w, m, strict=True) for b, y in zip(w, m, strict=True)
    )
    expected += sum(a * a * (t[i + 1] - t[i]) for i, a in enumerate(w)) / 3
    expected /= mpmath.mpf(depth.item())
    assert distortion_loss(weights, t_edges, depth).item() == pytest.approx(
        float(expected), rel=2e-6
    )


def test_empty_rays_are_0_and_still_count(dtype, finite_gradients):
    weights, t_edges, depth = (tensor.to(dtype) for tensor in random_rays(2))
    first = distortion_loss(weights[:1], t_edges[:1], depth[:1])
    weights[1] = torch.tensor([0, 5e-5, 0, 0, 0, 0, 0])
    for far in (0.0, 6.0, float("inf")):
        both = torch.stack([depth[0], depth.new_tensor(far)])
        rays = [tensor.clone().requires_grad_() for tensor in (weights, t_edges, both)]
        value = distortion_loss(*rays)
        torch.testing.assert_close(value, first / 2)
        for grad in finite_gradients(value, *rays):
            assert (grad[1] == 0).all()


@pytest.mark.parametrize("length", [0.0, 1e-30, 1e30])
def test_extreme_lengths(dtype, finite_gradients, length):
    weights = torch.tensor([[0.5, 0.5]], dtype=dtype, requires_grad=True)
    t_edges = torch.tensor([[1.0, 1 + length, 1 + 2 * length]], dtype=dtype)
    finite_gradients(distortion_loss(weights, t_edges, t_edges[:, 1]), weights)


@pytest.mark.parametrize("samples", [2, 48, 4096])
@pytest.mark.parametrize(
    ("low", "high"), [(2e-6, 6e-6), (2e6, 6e6), (10000.0, 10001.0), (0.0, 1e-9)]
)
def test_against_50_digits(dtype, samples, low, high):
    generator = torch.Generator().manual_seed(samples)
    edges = torch.rand(1, samples + 1, dtype=torch.float64, generator=generator).sort().values
    t_edges = (low + (high - low) * edges).to(dtype)
    weights = (
        torch.rand(1, samples, dtype=torch.float64, generator=generator).pow(8).to(dtype) / samples
    )
    depth = t_edges[:, -1]
    with mpmath.workdps(50):
        w, e = ([mpmath.mpf(x) for x in values[0].tolist()] for values in (weights, t_edges))
        m = [(a + b) / 2 for a, b in pairwise(e)]
        # sum_ij w_i w_j abs(m_i - m_j) for ascending m: 2 sum_j w_j (m_j W_<j - sum_{i<j} w_i m_i)
        total, before, moment = mpmath.mpf(0), mpmath.mpf(0), mpmath.mpf(0)
        for i in range(samples):
            total += 2 * w[i] * (m[i] * before - moment) + w[i] ** 2 * (e[i + 1] - e[i]) / 3
            before, moment = before + w[i], moment + w[i] * m[i]
        expected = total / e[-1]
    value = distortion_loss(weights, t_edges, depth).item()
    assert value == pytest.approx(float(expected), rel=1e-5 if dtype == torch.float32 else 1e-11)


@pytest.mark.parametrize("half", [torch.bfloat16, torch.float16])
def test_half_precision_is_computed_in_float32(half):
    rays = [tensor.to(half) for tensor in random_rays()]
    assert torch.equal(
        distortion_loss(*rays), distortion_loss(*(tensor.float() for tensor in rays))
    )


def test_one_sample(dtype, finite_gradients):
    # No gap; 1/3 w^2 delta / d = 1/3 * 1/4 * 2 / 2.
    weights = torch.tensor([[0.5]], dtype=dtype, requires_grad=True)
    value = distortion_loss(
        weights, torch.tensor([[1.0, 3.0]], dtype=dtype), torch.tensor([2.0], dtype=dtype)
    )
    assert value.item() == pytest.approx(1 / 12)
    finite_gradients(value, weights)


def test_gradcheck():
    assert torch.autograd.gradcheck(
        distortion_loss, [tensor.requires_grad_() for tensor in random_rays()]
    )


def test_doubling_the_batch_changes_nothing():
    rays = random_rays()
    torch.testing.assert_close(
        distortion_loss(*(torch.cat([x, x]) for x in rays)), distortion_loss(*rays)
    )


def test_units_cancel(dtype):
    weights, t_edges, depth = (tensor.to(dtype) for tensor in random_rays())
    torch.testing.assert_close(
        distortion_loss(weights, t_edges * 1024, depth * 1024),
        distortion_loss(weights, t_edges, depth),
    )


def two_rays(rendering):
    tau = torch.tensor([[0.5, 1.0, 0.5], [2.0, 0.1, 3.0]], dtype=torch.float64, requires_grad=True)
    return rendering(tau)


def test_loss(rendering, step):
    made = two_rays(rendering)
    expected = all_pairs(made.weights, made.t_edges, made.depth)
    torch.testing.assert_close(Distortion().nerfreg_loss(made, step())["distortion"], expected)


def test_loss_with_the_depth_detached(rendering, step):
    made = two_rays(rendering)
    detached = all_pairs(made.weights, made.t_edges, made.depth.detach())
    terms = Distortion(detach_depth=True).nerfreg_loss(made, step())
    args = {"inputs": made.tau, "retain_graph": True}
    torch.testing.assert_close(
        torch.autograd.grad(terms["distortion"], **args), torch.autograd.grad(detached, **args)
    )


def test_loss_as_in_the_authors_program(rendering, step):
    # Bounds 2 and 6: depth becomes the sum of w (m - 2) / 4, and 1e-4; the last interval is left
    # out.
    made = two_rays(rendering)
    middles = (made.t_edges[:, :-1] + made.t_edges[:, 1:]) / 2
    depth = (made.weights * (middles - 2) / 4).sum(dim=1) + 1e-4
    expected = all_pairs(made.weights[:, :-1], made.t_edges[:, :-1], depth)
    terms = Distortion(unit_depth=True, drop_last=True).nerfreg_loss(made, step())
    torch.testing.assert_close(terms["distortion"], expected)


def test_loss_of_some_rays_is_that_of_one_of_them(rendering, step):
    made = two_rays(rendering)
    each = [
        all_pairs(made.weights[i : i + 1], made.t_edges[i : i + 1], made.depth[i : i + 1])
        for i in (0, 1)
    ]
    chosen = {
        round(Distortion(max_rays=1).nerfreg_loss(made, state)["distortion"].item(), 9)
        for state in [step()]
        for _ in range(20)
    }
    assert chosen == {round(value.item(), 9) for value in each}
    torch.testing.assert_close(
        Distortion(max_rays=2).nerfreg_loss(made, step())["distortion"], (each[0] + each[1]) / 2
    )


def test_starts_after_a_tenth_of_the_budget(step):
    assert not Distortion().active(step(fraction=0.099))
    assert Distortion().active(step(fraction=0.1))
