from __future__ import annotations

import torch

from nerfreg.checks import compositor
from nerfreg.checks.cases import CASES
from nerfreg.checks.report import Report
from nerfreg.checks.run import COMPOSITOR, check_plugin
from nerfreg.rendering.compositing import composite

NAMES = ("fog", "thickness_1e-12", "thickness_1e30", "empty")


def check_named() -> Report:
    cases = [case for case in CASES if case.name in NAMES]
    return check_plugin(COMPOSITOR, cases, ("float32",), 48)


def subtracting(sigma, rgb, t_edges, background=None):
    """The textbook's 1 - exp(-tau), which is 0 in float32 for thicknesses below 6e-8."""
    result = composite(sigma, rgb, t_edges, background)
    result.weights = result.log_transmittance.exp() * (1 - torch.exp(-result.tau))
    return result


def test_ours_passes():
    report = check_named()
    assert report.failures == []
    assert report.worst["float32"].error < 2e-5


def test_cancellation_is_found(monkeypatch):
    monkeypatch.setattr(compositor, "composite", subtracting)
    failures = {(failure.spot.case, failure.check) for failure in check_named().failures}
    assert ("thickness_1e-12", "error") in failures
    # weights are lost where tau is 1e-12 / 48, and there alone
    assert {case for case, _ in failures} == {"thickness_1e-12"}


class Halved(torch.autograd.Function):
    """The same values, half the gradient."""

    @staticmethod
    def forward(ctx, x):
        return x.clone()

    @staticmethod
    def backward(ctx, grad):
        return grad / 2


def test_wrong_gradient_is_found(monkeypatch):
    grid = CASES[:1], ("float64",), 2
    assert check_plugin(COMPOSITOR, *grid).failures == []

    def halved(sigma, rgb, t_edges, background=None):
        result = composite(sigma, rgb, t_edges, background)
        result.depth = Halved.apply(result.depth)
        return result

    monkeypatch.setattr(compositor, "composite", halved)
    [failure] = check_plugin(COMPOSITOR, *grid).failures
    assert failure.check == "gradient"
