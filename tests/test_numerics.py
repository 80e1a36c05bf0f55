"""log(1 - exp(-tau)) against mpmath."""

from __future__ import annotations

import mpmath
import pytest
import torch

from nerfreg.numerics import log_alpha


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
        # at 80 and beyond exp(-tau) is below the digits of float32, and the exact value is below its normal numbers
        assert result.item() == pytest.approx(float(exact), rel=tolerance, abs=1e-35)
        assert value.grad.item() == pytest.approx(float(slope), rel=4 * tolerance, abs=1e-35)


def test_nothing_is_minus_infinity_without_a_gradient() -> None:
    tau = torch.tensor([0.0, 1.0], requires_grad=True)
    result = log_alpha(tau)
    assert result[0] == -torch.inf
    torch.where(torch.isfinite(result), result, torch.zeros_like(result)).sum().backward()
    assert tau.grad is not None and tau.grad[0] == 0 and torch.isfinite(tau.grad).all()
