"""Plugins that are wrong in ways which training would not show until it is too late."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import mpmath
import pytest
import torch
from torch import nn

from nerfreg import Needs, Regularizer, hookimpl
from nerfreg.checks.report import Report
from nerfreg.checks.run import ALL_CASES
from nerfreg.checks.run import check_plugin as check
from nerfreg.checks.subject import Subject
from nerfreg.field.layers import AffineLayer
from nerfreg.numerics import exact

SIZE = 48


def check_plugin(
    subject: Subject, *names: str, dtype: str = "float32", samples: int = SIZE
) -> Report:
    """Check the named cases."""
    cases = [case for case in ALL_CASES if case.name in names]
    return check(subject, cases, (dtype,), samples)


@dataclass
class LogOfZero(Regularizer):
    """Entropy of the weights without 0 log 0 = 0."""

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": -(rendering.weights * rendering.weights.log()).sum(-1).mean()}


def test_log_of_zero(subject):
    report = check_plugin(subject(LogOfZero), "fog", "wall_first", "empty")
    # 0 log 0 is NaN; in fog every weight is positive, and nothing is wrong
    assert {(failure.spot.case, failure.check) for failure in report.failures} == {
        ("wall_first", "value"),
        ("empty", "value"),
    }
    assert {failure.message for failure in report.failures} == {"term 'suspect' is nan"}


@dataclass
class GradientOfRoot(Regularizer):
    """A finite value whose gradient is not: the square root at 0."""

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": rendering.weights.sqrt().sum(-1).mean()}


def test_infinite_gradient_of_a_finite_value(subject):
    report = check_plugin(subject(GradientOfRoot), "fog", "empty")
    assert report.state("value") == "ok"
    assert {(failure.spot.case, failure.check) for failure in report.failures} == {
        ("empty", "gradient")
    }


@dataclass
class PrefixSums(Regularizer):
    """Distortion as sums of w_i m_i W_{<i} minus sums of w_i M_{<i}, with its exact value."""

    @hookimpl
    def nerfreg_loss(self, rendering):
        weights, edges = rendering.weights, rendering.t_edges
        middles = (edges[:, 1:] + edges[:, :-1]) / 2
        before = weights.cumsum(-1) - weights
        moment = (weights * middles).cumsum(-1) - weights * middles
        between = 2 * (weights * middles * before - weights * moment).sum(-1)
        return {"suspect": (between + (weights.square() * edges.diff()).sum(-1) / 3).mean()}

    @hookimpl
    def nerfreg_reference(self, given):
        rays = []
        for weights, edges in zip(exact(given.weights), exact(given.t_edges), strict=True):
            middles = [(low + high) / 2 for low, high in pairwise(edges)]
            pairs = [
                a * b * abs(m - n)
                for a, m in zip(weights, middles, strict=True)
                for b, n in zip(weights, middles, strict=True)
            ]
            own = [
                w**2 * (high - low) / 3
                for w, (low, high) in zip(weights, pairwise(edges), strict=True)
            ]
            rays.append(mpmath.fsum(pairs) + mpmath.fsum(own))
        return {"suspect": mpmath.fsum(rays) / len(rays)}


def test_prefix_sums_cancel(subject):
    report = check_plugin(subject(PrefixSums), "fog", "packed", samples=12)
    assert {(failure.spot.case, failure.check) for failure in report.failures} == {
        ("packed", "error")
    }
    assert report.worst["float32"].spot.case == "packed"
    assert report.worst["float32"].exact
    # between 10000 and 10001 a product w m carries a rounding error of about 1e4 * 6e-8,
    # against a spread below 1
    assert 1e-5 < report.worst["float32"].error < 1e-1


@dataclass
class UnguardedDivision(Regularizer):
    """Normalised weights, whatever their sum."""

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": (rendering.weights / rendering.opacity[:, None]).square().sum(-1).mean()}


def test_unguarded_division(subject):
    report = check_plugin(subject(UnguardedDivision), "fog", "missing_depth", "near_is_far")
    assert {(failure.spot.case, failure.check) for failure in report.failures} == {
        ("missing_depth", "value"),
        ("near_is_far", "value"),
    }


class WrongSign(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x):
        ctx.save_for_backward(x)
        return x.square()

    @staticmethod
    def backward(ctx, grad):
        (x,) = ctx.saved_tensors
        return -2 * x * grad


@dataclass
class WrongGradientSign(Regularizer):
    """The squared opacity, whose hand-written gradient points the wrong way."""

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": WrongSign.apply(rendering.opacity).mean()}


def test_wrong_gradient_sign(subject):
    report = check_plugin(subject(WrongGradientSign), "fog", "empty", dtype="float64")
    [failure] = report.failures
    assert (failure.spot.case, failure.spot.dtype, failure.check) == ("fog", "float64", "gradient")
    words = failure.message.replace(",", "").split()
    by_autograd, by_differences = (
        float(words[words.index("by") - 1]),
        float(words[words.index("finite") - 2]),
    )
    assert by_autograd == pytest.approx(-by_differences, rel=1e-4)


@dataclass
class EditsInPlace(Regularizer):
    """Normalises the weights where they are."""

    @hookimpl
    def nerfreg_loss(self, rendering):
        with torch.no_grad():
            rendering.weights.div_(rendering.opacity[:, None].clamp_min(1e-3))
        return {"suspect": rendering.opacity.mean()}


def test_edit_of_the_rendering(subject):
    report = check_plugin(subject(EditsInPlace), "fog")
    [failure] = report.failures
    assert (failure.spot.case, failure.check) == ("fog", "value")
    assert failure.message == "weights has been edited in place"


@dataclass
class SumOverRays(Regularizer):
    """Depends on the size of the batch, and through ray 0 on its order."""

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"sum": rendering.opacity.sum(), "first": rendering.opacity[0] + 0}


def test_size_and_order_of_the_batch(subject):
    report = check_plugin(subject(SumOverRays), "fog")
    found = {failure.message.partition(":")[0] for failure in report.failures}
    assert found == {
        "term 'sum' depends on twice the same rays",
        "term 'first' depends on the order of the rays",
    }
    assert {failure.check for failure in report.failures} == {"invariance"}


@dataclass
class ClaimsToBeScaleFree(Regularizer):
    """Mean depth, in world units."""

    @property
    def scale_free(self):
        return True

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": rendering.depth.mean()}


def test_scale(subject):
    [failure] = check_plugin(subject(ClaimsToBeScaleFree), "fog").failures
    assert failure.check == "invariance"
    assert failure.message.startswith("term 'suspect' depends on a scene 1024 times as large")


@dataclass
class SwappedBounds(Regularizer):
    """near and far the wrong way round."""

    @hookimpl
    def nerfreg_ray_bounds(self, rays):
        return rays.far, rays.near


def test_near_beyond_far(subject):
    report = check_plugin(subject(SwappedBounds), "fog", "near_is_far")
    assert {(failure.spot.case, failure.check) for failure in report.failures} == {
        ("fog", "contract")
    }
    assert report.failures[0].message.startswith("at 0 of the run: near > far on 20 of 20 rays")


@dataclass
class InexactBounds(Regularizer):
    """Ships an exact value that it misses by 1e-3."""

    @hookimpl
    def nerfreg_ray_bounds(self, rays):
        return rays.near, rays.far * 1.001

    @hookimpl
    def nerfreg_reference(self, given):
        return {"near": exact(given.near), "far": exact(given.far)}


def test_bounds_off_their_exact_value(subject):
    report = check_plugin(subject(InexactBounds), "fog")
    assert {failure.check for failure in report.failures} == {"error"}
    assert report.worst["float32"].error == pytest.approx(1e-3, rel=1e-3)


@dataclass
class ShiftsInPlace(Regularizer):
    """Moves the positions that it is given."""

    @hookimpl(wrapper=True)
    def nerfreg_encoder_input(self):
        samples = yield
        samples.positions.add_(1.0)
        return samples


def test_edit_of_the_samples(subject):
    report = check_plugin(subject(ShiftsInPlace), "fog")
    assert report.failures[0].check == "contract"
    assert report.failures[0].message == "at 0 of the run: positions has been edited in place"


@dataclass
class TooManyFeatures(Regularizer):
    """Asks for more features than there are."""

    @hookimpl(wrapper=True)
    def nerfreg_encoder_input(self):
        samples = yield
        return replace(samples, density_features=samples.density_width + 1.0)


def test_features_that_do_not_exist(subject):
    report = check_plugin(subject(TooManyFeatures), "fog")
    assert "density_features=9.0: must be None, or between 0 and 8" in report.failures[0].message


class Unbounded(AffineLayer):
    """Says that its rows are bounded by 1, and does nothing for it."""

    def __init__(self, in_features, out_features, activation):
        super().__init__(activation)
        self.weight = nn.Parameter(torch.full((out_features, in_features), 1.0 / in_features))
        self.k = nn.Parameter(torch.tensor(0.0))

    def effective(self):
        return self.weight, None


@dataclass
class UnboundedRows(Regularizer):
    def __post_init__(self):
        self._layers = []

    @hookimpl
    def nerfreg_layer(self, in_features, out_features, activation):
        self._layers.append(Unbounded(in_features, out_features, activation))
        return self._layers[-1]

    @hookimpl
    def nerfreg_contract(self):
        return {
            "rows": max(float(layer.weight.detach().abs().sum(-1).max()) for layer in self._layers)
            - 1
        }


def test_contract_of_a_layer(subject):
    report = check_plugin(subject(UnboundedRows), "layer_initial")
    [failure] = report.failures
    # rows of 1e30 in a layer with 8 inputs sum to 8e30
    assert (failure.spot.case, failure.check, failure.message) == (
        "layer_initial",
        "contract",
        "promise broken: rows, by 8e+30",
    )
    assert (
        report.reproduction(failure.spot)
        == "nerfreg check suspect --case layer_initial --dtype float32"
    )


class Exponential(Unbounded):
    """exp(k) overflows in float32 from 89 on."""

    def effective(self):
        return self.weight.clamp(-1, 1) * self.k.exp(), None


@dataclass
class OverflowingLayer(Regularizer):
    @hookimpl
    def nerfreg_layer(self, in_features, out_features, activation):
        return Exponential(in_features, out_features, activation)


def test_overflow_of_a_layer(subject):
    report = check_plugin(subject(OverflowingLayer), "layer_-50", "layer_0", "layer_1e4")
    assert {(failure.spot.case, failure.check) for failure in report.failures} >= {
        ("layer_1e4", "value")
    }
    assert {failure.spot.case for failure in report.failures} == {"layer_1e4"}


class Deceiving(Unbounded):
    def forward(self, x):
        return 2 * super().forward(x)


@dataclass
class DeceivingLayer(Regularizer):
    @hookimpl
    def nerfreg_layer(self, in_features, out_features, activation):
        return Deceiving(in_features, out_features, activation)


def test_layer_that_does_not_compute_what_it_says(subject):
    report = check_plugin(subject(DeceivingLayer), "layer_0")
    expected = "layer 0 of density: its output is not that of its effective weight and bias"
    assert report.failures[0].message == expected


@dataclass
class AsksTooMuch(Regularizer):
    """Wants more rays in patches than there are."""

    @hookimpl
    def nerfreg_needs(self):
        return Needs(patch_fraction=1.5)


def test_needs_beyond_the_batch(subject):
    [*failures] = check_plugin(subject(AsksTooMuch), "fog").failures
    assert {failure.check for failure in failures} == {"contract"}
    assert "patch_fraction=1.5" in failures[0].message


@dataclass
class Raises(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering):
        raise ValueError("no such thing\nmore of it")


def test_exception_is_a_failure_of_the_case(subject):
    report = check_plugin(subject(Raises), "fog", "empty")
    assert [failure.message for failure in report.failures] == [
        "raises ValueError: no such thing"
    ] * 2
    assert report.verdict == "FAIL"


@dataclass
class StopsGradient(Regularizer):
    """A factor held constant on purpose is no wrong gradient."""

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": (rendering.opacity * rendering.depth.detach()).mean()}


def test_deliberate_stop_of_the_gradient_is_right(subject):
    report = check_plugin(subject(StopsGradient), "fog", dtype="float64")
    assert report.failures == []
    assert report.state("gradient") == "ok"


@dataclass
class LosesDigits(Regularizer):
    """Without an exact value: 1 - exp(-tau) of nearly transparent rays, by subtraction."""

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": (1 - torch.exp(-rendering.tau.sum(-1))).mean()}


def test_own_value_in_float64_where_there_is_no_exact_one(subject):
    report = check_plugin(subject(LosesDigits), "just_empty")
    # The rays' opacities of 1e-4 are differences from 1, whose rounding is up to 6e-8: parts of
    # 6e-4, less in the mean.
    worst = report.worst["float32"]
    assert not worst.exact
    assert 1e-6 < worst.error < 6e-4
    # reported, and a failure only above 1e-3
    assert report.failures == []
