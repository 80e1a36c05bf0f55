from __future__ import annotations

import pytest
import torch
from nerfreg_plugins.occlusion import Occlusion, Quantity, occlusion_loss


def four_samples(weights, dtype):
    """Edges 2 3 4 5 6, midpoints 2.5 to 5.5."""
    count = len(weights)
    edges = torch.arange(2.0, 7.0, dtype=dtype).expand(count, -1)
    return torch.tensor(weights, dtype=dtype, requires_grad=True), edges, edges[:, 0], edges[:, -1]


@pytest.mark.parametrize(
    ("fraction", "expected"),
    # The border lies at 2, 2.4, 3, 4, and 6 (and beyond): none, none, 1, 2, and 4 midpoints are
    # below.
    [(0.0, 0.0), (0.1, 0.0), (0.25, 0.4), (0.5, 0.3), (1.0, 0.25), (2.0, 0.25)],
)
def test_by_hand(dtype, finite_gradients, fraction, expected):
    weights, *rest = four_samples([[0.4, 0.2, 0.1, 0.3]], dtype)
    value = occlusion_loss(weights, *rest, fraction)
    assert value.item() == pytest.approx(expected)
    finite_gradients(value, weights)


def test_rays_that_start_inside_matter(dtype, finite_gradients):
    # The whole weight lies in the first of two near samples.
    weights, *rest = four_samples([[1.0, 0.0, 0.0, 0.0]], dtype)
    value = occlusion_loss(weights, *rest, 0.5)
    assert value.item() == 0.5
    assert finite_gradients(value, weights)[0].tolist() == [[0.5, 0.5, 0.0, 0.0]]


def test_each_ray_has_its_own_bounds(dtype):
    weights, edges, near, far = four_samples([[0.4, 0.2, 0.1, 0.3], [0.4, 0.2, 0.1, 0.3]], dtype)
    far = torch.stack([far[0], far[1] * 0 + 3])
    # Half of [2, 6] holds two midpoints, half of [2, 3] none: below 2.5, not at it.
    assert occlusion_loss(weights, edges, near, far, 0.5).item() == pytest.approx(0.3 / 2)


def test_packed_samples(dtype):
    # All of the samples within the first tenth: their plain mean.
    weights = torch.tensor([[0.1, 0.3]], dtype=dtype)
    edges = torch.tensor([[2.0, 2.0 + 1e-6, 2.0 + 2e-6]], dtype=dtype)
    value = occlusion_loss(
        weights, edges, torch.tensor([2.0], dtype=dtype), torch.tensor([6.0], dtype=dtype), 0.1
    )
    assert value.item() == pytest.approx(0.2)


def test_gradcheck_and_doubling_the_batch():
    weights, edges, near, far = four_samples(
        [[0.4, 0.2, 0.1, 0.3], [0.1, 0.1, 0.1, 0.1]], torch.float64
    )
    assert torch.autograd.gradcheck(lambda w: occlusion_loss(w, edges, near, far, 0.5), weights)
    double = (torch.cat([x, x]) for x in (weights, edges, near, far))
    torch.testing.assert_close(
        occlusion_loss(*double, 0.5), occlusion_loss(weights, edges, near, far, 0.5)
    )


@pytest.mark.parametrize("half", [torch.bfloat16, torch.float16])
def test_half_precision_is_computed_in_float32(half):
    rays = four_samples([[0.4, 0.2, 0.1, 0.3]], half)
    assert torch.equal(
        occlusion_loss(*rays, 0.5), occlusion_loss(*(tensor.float() for tensor in rays), 0.5)
    )


def test_far_away_the_border_is_exact(dtype):
    # Between 10000 and 10001 float32 steps by 1/1024: the midpoint 1/2048 below the border needs
    # one digit more.
    ulp = 1 / 1024
    edges = torch.tensor([[10000.5 - ulp, 10000.5, 10000.5 + ulp]], dtype=dtype)
    near, far = torch.tensor([10000.0], dtype=dtype), torch.tensor([10001.0], dtype=dtype)
    assert (
        occlusion_loss(torch.tensor([[0.25, 0.5]], dtype=dtype), edges, near, far, 0.5).item()
        == 0.25
    )


def test_loss(rendering):
    # Four intervals of length 1 with tau 2: the first weight is 1 - exp(-2), the first density 2.
    made = rendering(torch.full((3, 4), 2.0))
    assert Occlusion(fraction=0.25).nerfreg_loss(made)["occlusion"].item() == pytest.approx(
        0.8646647
    )
    assert (
        Occlusion(fraction=0.25, quantity=Quantity.density).nerfreg_loss(made)["occlusion"].item()
        == 2
    )


def test_infinite_thickness(rendering, dtype, finite_gradients):
    tau = torch.tensor([[1e30, 0.0, 0.0, 0.0]], dtype=dtype, requires_grad=True)
    term = Occlusion(fraction=0.5).nerfreg_loss(rendering(tau))["occlusion"]
    assert term.item() == 0.5
    finite_gradients(term, tau)
