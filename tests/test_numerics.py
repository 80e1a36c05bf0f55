"""log(1 - exp(-tau)) against mpmath."""

from __future__ import annotations

import mpmath
import pytest
import torch

from nerfreg.numerics import double, exact, log_alpha, of_rays, one_minus_sum, ray_samples, single


@pytest.mark.parametrize("tau", [1e-30, 1e-12, 1e-3, 0.5, 0.6931, 0.6932, 1.0, 20.0, 80.0, 1e4])
def test_against_mpmath(tau: float) -> None:
    for dtype, tolerance in ((torch.float32, 1e-6), (torch.float64, 1e-14)):
        value = torch.tensor(tau, dtype=dtype, requires_grad=True)
        with mpmath.workdps(50):
            exact = mpmath.log(1 - mpmath.exp(-mpmath.mpf(value.item())))
            slope = 1 / mpmath.expm1(mpmath.mpf(value.item()))
        result = log_alpha(value)
        result.backward()
        assert value.grad is not None
        # From 80 on exp(-tau) is below the precision of float32, and the exact value is below its
        # normal numbers.
        assert result.item() == pytest.approx(float(exact), rel=tolerance, abs=1e-35)
        assert value.grad.item() == pytest.approx(float(slope), rel=4 * tolerance, abs=1e-35)


@pytest.mark.parametrize("count", [1, 2, 7, 64])
def test_what_a_sum_misses_of_one(count: int) -> None:
    # 1 - 1/2 - 1/2 - 2^-60 (count - 2): the sum itself rounds to 1 even in float64.
    x = torch.full((1, count), 2.0**-60, dtype=torch.float64)
    x[0, : min(count, 2)] = 0.5
    expected = 0.5 if count == 1 else -(count - 2) * 2.0**-60
    assert one_minus_sum(x).item() == expected


def test_half_precision_becomes_single() -> None:
    for given, expected in {
        torch.bfloat16: torch.float32,
        torch.float16: torch.float32,
        torch.float32: torch.float32,
        torch.float64: torch.float64,
    }.items():
        assert single(torch.ones(1, dtype=given)).dtype == expected
        assert double(torch.ones(1, dtype=given)).dtype == torch.float64


def test_exact_numbers_are_nested_like_the_tensor() -> None:
    values = exact(torch.tensor([[0.1, 2.0]], dtype=torch.float32))
    # the nearest float32 to 0.1
    assert values == [[mpmath.mpf(13421773) / 134217728, mpmath.mpf(2)]]


def test_subnormal_thickness_counts_as_none() -> None:
    # d log(1 - exp(-tau)) / dtau is 1 / tau, beyond float32 for tau of 1e-40.
    tau = torch.tensor([1e-40, 1e-37], requires_grad=True)
    result = log_alpha(tau)
    assert result[0] == -torch.inf
    result[1:].sum().backward()
    assert tau.grad is not None and tau.grad.tolist() == [0, pytest.approx(1e37)]


def test_nothing_is_minus_infinity_without_a_gradient() -> None:
    tau = torch.tensor([0.0, 1.0], requires_grad=True)
    result = log_alpha(tau)
    assert result[0] == -torch.inf
    torch.where(torch.isfinite(result), result, torch.zeros_like(result)).sum().backward()
    assert tau.grad is not None and tau.grad[0] == 0 and torch.isfinite(tau.grad).all()


def test_a_last_axis_of_one_is_left_out() -> None:
    depth = torch.rand(3, 1)
    assert torch.equal(of_rays("depth", depth, 1), depth[:, 0])
    assert of_rays("weights", torch.rand(3, 1), 2).shape == (3, 1)  # one sample, not one too many
    weights, edges = ray_samples(torch.rand(3, 4, 1), torch.rand(3, 5))
    assert (weights.shape, edges.shape) == ((3, 4), (3, 5))


def test_another_shape_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"^depth has shape \(3, 4\), not 1 axes$"):
        of_rays("depth", torch.rand(3, 4), 1)
    borders = r"^t_edges has shape \(3, 4\), not 2 axes, the last of them of length 5$"
    with pytest.raises(ValueError, match=borders):
        ray_samples(torch.rand(3, 4), torch.rand(3, 4))
