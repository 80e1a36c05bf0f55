"""Compositing against hand-worked slabs and mpmath, and on stiff rays."""

from __future__ import annotations

import math

import mpmath
import pytest
import torch

from nerfreg.rendering.compositing import composite, integrate

SPEEDS = (0.0, 1e-12, 1e-4, 1.0, 50.0, 1e6, 1e30)


def test_two_slabs_by_hand() -> None:
    # Edges 0, 1, 3; densities ln 2 and ln 2 / 2: each slab halves the light. Weights 1/2, 1/4;
    # opacity 3/4; depth (1/2 * 0.5 + 1/4 * 2) / (3/4) = 1; colour 1/2 red + 1/4 green + 1/4 of a
    # blue background.
    sigma = torch.tensor([[math.log(2), math.log(2) / 2]])
    rgb = torch.tensor([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    result = composite(sigma, rgb, torch.tensor([[0.0, 1.0, 3.0]]), torch.tensor([0.0, 0.0, 1.0]))
    torch.testing.assert_close(result.weights, torch.tensor([[0.5, 0.25]]))
    torch.testing.assert_close(result.opacity, torch.tensor([0.75]))
    torch.testing.assert_close(result.depth, torch.tensor([1.0]))
    assert result.rgb is not None
    torch.testing.assert_close(result.rgb, torch.tensor([[0.5, 0.25, 0.25]]))


def test_without_a_background_nothing_is_added() -> None:
    result = composite(torch.zeros(1, 4), torch.ones(1, 4, 3), torch.arange(5.0)[None])
    assert result.rgb is not None
    assert torch.equal(result.rgb, torch.zeros(1, 3))


@pytest.mark.parametrize("dtype, tolerance", [(torch.float32, 2e-5), (torch.float64, 1e-11)])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_against_mpmath(dtype: torch.dtype, tolerance: float, scale: float) -> None:
    torch.manual_seed(0)
    edges = (torch.rand(1, 49, dtype=torch.float64).cumsum(1) * scale).to(dtype)
    sigma = (torch.randn(1, 48, dtype=torch.float64).mul(3).exp() / scale).to(dtype)
    result = integrate(sigma, edges)
    with mpmath.workdps(40):
        # The optical thicknesses as given: rounding of the inputs is not compositing's error.
        tau = [mpmath.mpf(value) for value in (sigma * edges.diff(dim=1))[0].tolist()]
        sums = [mpmath.fsum(tau[:i]) for i in range(49)]
        weights = [mpmath.exp(-sums[i]) * -mpmath.expm1(-tau[i]) for i in range(48)]
        middle = [
            (mpmath.mpf(a) + mpmath.mpf(b)) / 2
            for a, b in zip(edges[0, :-1].tolist(), edges[0, 1:].tolist(), strict=True)
        ]
        opacity = -mpmath.expm1(-sums[48])
        depth = mpmath.fsum(w * m for w, m in zip(weights, middle, strict=True)) / mpmath.fsum(
            weights
        )
    tiny = torch.finfo(dtype).tiny
    for value, exact in zip(result.weights[0].tolist(), weights, strict=True):
        assert value == pytest.approx(float(exact), rel=tolerance, abs=tiny)
    assert result.opacity.item() == pytest.approx(float(opacity), rel=tolerance)
    assert result.depth.item() == pytest.approx(float(depth), rel=tolerance)


@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize("place", [0, 3, 7])
def test_a_wall_anywhere_gives_finite_values_and_gradients(speed: float, place: int) -> None:
    sigma = torch.zeros(1, 8)
    sigma[0, place] = speed
    sigma.requires_grad_()
    edges = torch.linspace(1, 9, 9)[None]
    result = composite(sigma, torch.ones(1, 8, 3), edges, torch.zeros(3))
    assert result.rgb is not None
    (result.rgb.sum() + result.depth.sum() + result.opacity.sum()).backward()
    assert result.opacity.item() == pytest.approx(-math.expm1(-speed), rel=1e-6)
    assert result.depth.item() == pytest.approx(
        place + 1.5 if result.opacity.item() >= 1e-4 else 9.0
    )
    assert sigma.grad is not None and torch.isfinite(sigma.grad).all()
    assert (result.weights >= 0).all() and (result.weights.sum() <= 1 + 1e-6)


def test_zero_width_intervals_and_a_single_sample() -> None:
    edges = torch.tensor([[1.0, 1.0, 2.0, 2.0]])
    result = integrate(torch.full((1, 3), 5.0), edges)
    assert result.weights[0, 0] == 0 and result.weights[0, 2] == 0
    single = integrate(torch.tensor([[1.0]]), torch.tensor([[0.0, 1.0]]))
    assert single.opacity.item() == pytest.approx(1 - math.exp(-1))


def test_gradients_match_finite_differences() -> None:
    torch.manual_seed(0)
    sigma = torch.rand(2, 5, dtype=torch.float64).add(0.1).requires_grad_()
    edges = torch.rand(2, 6, dtype=torch.float64).cumsum(1).requires_grad_()

    def everything(sigma: torch.Tensor, edges: torch.Tensor) -> tuple[torch.Tensor, ...]:
        result = integrate(sigma, edges)
        return result.weights, result.opacity, result.depth, result.log_transmittance

    assert torch.autograd.gradcheck(everything, (sigma, edges))
