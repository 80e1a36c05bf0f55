from __future__ import annotations

import math

import pytest
import torch
from nerfreg_plugins.lipschitz import (
    Activation,
    BoundedNetwork,
    Lipschitz,
    LipschitzLinear,
    normalize_rows,
    softplus,
)
from torch.nn import functional

from nerfreg.field.layers import Linear
from nerfreg.registry import Hooks


def inverse_softplus(bound: float) -> float:
    return math.log(math.expm1(bound))


def test_by_hand(dtype):
    # Bound 2: row sums 1 (kept), 4 (halved), 2 (kept), 0 (kept).
    weight = torch.tensor([[0.5, -0.5], [-1.0, 3.0], [2.0, 0.0], [0.0, 0.0]], dtype=dtype)
    k = torch.tensor(inverse_softplus(2.0), dtype=dtype)
    expected = torch.tensor([[0.5, -0.5], [-0.5, 1.5], [2.0, 0.0], [0.0, 0.0]], dtype=dtype)
    torch.testing.assert_close(normalize_rows(weight, k), expected)


@pytest.mark.parametrize("k", [-1e4, -200.0, -50.0, -1.0, 0.0, 25.0, 80.0, 1e4])
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e6])
def test_extreme_bounds_and_rows(dtype, finite_gradients, k, scale):
    weight = torch.tensor([[1.0, -2.0], [0.0, 0.0], [0.0, 1e-8]], dtype=dtype) * scale
    weight.requires_grad_()
    bound = torch.tensor(k, dtype=dtype, requires_grad=True)
    rows = normalize_rows(weight, bound)
    finite_gradients(rows.sum(), weight, bound)
    exact = k if k > 50 else math.log1p(math.exp(k))
    for row, limit in zip(
        rows.abs().sum(-1).tolist(), weight.detach().abs().sum(-1).tolist(), strict=True
    ):
        assert row == pytest.approx(min(limit, exact), rel=1e-5, abs=1e-44)
    assert (rows[1] == 0).all()


@pytest.mark.parametrize("k", [-50.0, 0.0, 1e4])
def test_huge_rows_come_down_to_the_bound(finite_gradients, k):
    # Four entries of 1e38 overflow float32 in their sum: each becomes a quarter of the bound.
    weight = torch.full((1, 4), 1e38, requires_grad=True)
    bound = torch.tensor(k, requires_grad=True)
    rows = normalize_rows(weight, bound)
    exact = k if k > 50 else math.log1p(math.exp(k))
    assert rows[0].tolist() == pytest.approx([exact / 4] * 4, rel=1e-6)
    # The row is as long as its bound: d softplus(k) / dk = 1 / (1 + exp(-k)).
    assert finite_gradients(rows.sum(), weight, bound)[1].item() == pytest.approx(
        1 / (1 + math.exp(-k)), rel=1e-5
    )


@pytest.mark.parametrize("half", [torch.bfloat16, torch.float16])
def test_half_precision_is_computed_in_float32(half):
    weight = torch.randn(5, 3, generator=torch.Generator().manual_seed(0)).to(half)
    k = torch.tensor(0.5, dtype=half)
    assert torch.equal(
        normalize_rows(weight, k), normalize_rows(weight.float(), k.float()).to(half)
    )


@pytest.mark.parametrize("k", [-50.0, -5.0, 21.0, 1e4])
def test_softplus_is_exact(k):
    # torch's own is linear from 20 on, where log(1 + exp(21)) still differs from 21 by 7.6e-10.
    value = softplus(torch.tensor(k, dtype=torch.float64)).item()
    assert value == pytest.approx(
        k + math.log1p(math.exp(-k)) if k > 0 else math.log1p(math.exp(k)), rel=1e-15
    )


def test_rows_within_the_bound_are_exact():
    weight = torch.rand(8, 8, generator=torch.Generator().manual_seed(0))
    assert torch.equal(normalize_rows(weight, torch.tensor(100.0)), weight)


def test_gradcheck():
    weight = torch.randn(
        5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)
    ).requires_grad_()
    k = torch.tensor(1.5, dtype=torch.float64, requires_grad=True)
    sums = weight.detach().abs().sum(-1)
    assert sums.min() < softplus(k.detach()) < sums.max(), "both branches are checked"
    assert torch.autograd.gradcheck(normalize_rows, (weight, k))


@pytest.mark.parametrize("activation", ["none", "relu", "gelu"])
def test_layer_starts_inactive_as_a_linear_one(activation):
    torch.manual_seed(0)
    layer = LipschitzLinear(32, 64, activation, bias=True)
    torch.manual_seed(0)
    linear = torch.nn.Linear(32, 64)
    x = torch.randn(10, 32)
    after = {"none": lambda y: y, "relu": functional.relu, "gelu": functional.gelu}[activation]
    torch.testing.assert_close(layer(x), after(linear(x)))
    assert layer.k.item() == pytest.approx(2 * linear.weight.abs().sum(-1).max().item())


def test_layer_keeps_its_bound():
    # |f(x) - f(y)|_inf <= softplus(k) |x - y|_inf, and the bound is reached by the signs of a row.
    layer = LipschitzLinear(16, 8, "none")
    layer.k.data = torch.tensor(inverse_softplus(0.5))
    signs = layer.weight.detach()[0].sign()[None]
    assert layer(signs).abs().max().item() == pytest.approx(0.5)
    x = torch.rand(100, 16) * 2 - 1
    assert layer(x).abs().max().item() <= 0.5 + 1e-6


def test_k_and_weight_are_trained():
    layer = LipschitzLinear(4, 4, "none")
    layer.k.data = torch.tensor(-1.0)
    layer(torch.ones(1, 4)).sum().backward()
    assert {name for name, p in layer.named_parameters() if p.grad is not None} == {"weight", "k"}


def test_layer_factory():
    hooks = Hooks({"lipschitz": Lipschitz(networks=[BoundedNetwork.color])})
    assert isinstance(hooks.layer("density", 0, 3, 4, "relu"), Linear)
    hidden = hooks.layer("color", 0, 3, 4, "relu")
    assert isinstance(hidden, LipschitzLinear)
    assert (hidden.weight.shape, hidden.bias, hidden.activation) == ((4, 3), None, "relu")


def test_layer_factory_as_in_the_authors_program():
    hooks = Hooks({"lipschitz": Lipschitz(bias=True, hidden_activation=Activation.gelu)})
    hidden, last = hooks.layer("density", 0, 3, 4, "relu"), hooks.layer("density", 1, 4, 2, "none")
    assert (hidden.activation, last.activation) == ("gelu", "none")
    assert last.bias.shape == (2,)


def test_loss_on_the_bounds(finite_gradients):
    plugin = Lipschitz(bound_weight=0.5)
    layers = [plugin.nerfreg_layer("density", i, 2, 2, "none") for i in (0, 1)]
    for layer, bound in zip(layers, (2.0, 3.0), strict=True):
        layer.k.data = torch.tensor(inverse_softplus(bound))
    value = plugin.nerfreg_loss()["lipschitz"]
    assert value.item() == pytest.approx(0.5 * 2 * 3)
    finite_gradients(value, layers[0].k, layers[1].k)


def test_no_loss_by_default():
    plugin = Lipschitz()
    plugin.nerfreg_layer("density", 0, 2, 2, "none")
    assert plugin.nerfreg_loss() == {}
