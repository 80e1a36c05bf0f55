"""The fused network against plain autograd, and the layer factory's contract."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from nerfreg.field.fused import CHUNK
from nerfreg.field.layers import AffineLayer, Linear
from nerfreg.field.network import Network


class WithBias(AffineLayer):
    """An affine layer whose effective weight is made of something else."""

    def __init__(self, inputs: int, outputs: int, activation: str) -> None:
        super().__init__(activation)
        self.raw = nn.Parameter(torch.randn(outputs, inputs))
        self.shift = nn.Parameter(torch.randn(outputs))

    def effective(self) -> tuple[Tensor, Tensor]:
        return self.raw / self.raw.abs().sum(dim=1, keepdim=True), self.shift


class Stranger(nn.Module):
    """A layer that is not affine."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.inner = nn.Linear(inputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        return torch.sin(self.inner(x))


NETWORKS = {
    "relu": lambda: [Linear(6, 16, "relu"), Linear(16, 16, "relu"), Linear(16, 3)],
    "gelu": lambda: [WithBias(6, 16, "gelu"), WithBias(16, 16, "gelu"), WithBias(16, 3, "none")],
    "one layer": lambda: [Linear(6, 3)],
    "mixed": lambda: [WithBias(6, 16, "relu"), Linear(16, 3, "none")],
    "gelu at the end": lambda: [Linear(6, 3, "gelu")],
}


@pytest.mark.parametrize("name", [name for name in NETWORKS if name != "gelu at the end"])
@pytest.mark.parametrize("points", [0, 1, CHUNK, 2 * CHUNK + 7])
def test_fused_equals_plain_forward_and_backward(name: str, points: int) -> None:
    torch.manual_seed(0)
    network = Network(NETWORKS[name]())
    x = torch.randn(points, 6)
    upstream = torch.randn(points, 3)
    results = []
    for plain in (True, False):
        network.zero_grad(set_to_none=True)
        inputs = x.clone().requires_grad_()
        out = network(inputs, plain=plain)
        out.backward(upstream)
        results.append([out.detach(), inputs.grad, *(p.grad for p in network.parameters())])
    for plain_value, fused_value in zip(*results, strict=True):
        scale = float(plain_value.abs().max()) if plain_value.numel() else 0.0
        torch.testing.assert_close(fused_value, plain_value, rtol=1e-4, atol=1e-5 * scale)


def test_gradients_match_finite_differences() -> None:
    torch.manual_seed(0)
    for make in ("relu", "gelu"):
        network = Network(NETWORKS[make]()).double()
        x = torch.randn(4, 6, dtype=torch.float64, requires_grad=True)
        assert torch.autograd.gradcheck(lambda v, n=network: n(v), (x,))


def test_the_result_without_gradient_is_the_same() -> None:
    network = Network(NETWORKS["gelu"]())
    x = torch.randn(CHUNK + 5, 6)
    with torch.no_grad():
        kept_nothing = network(x)
    torch.testing.assert_close(kept_nothing, network(x).detach(), rtol=0, atol=0)


@pytest.mark.parametrize("plain", [False, True])
def test_a_column_in_the_gap_has_no_part(plain: bool) -> None:
    torch.manual_seed(0)
    network = Network([Linear(5, 8, "relu"), Linear(8, 3)])
    x = torch.randn(10, 6, requires_grad=True)
    value = network(x, gap=2, plain=plain)
    torch.testing.assert_close(value, network(x[:, [0, 1, 3, 4, 5]], plain=True))
    value.sum().backward()
    assert (
        x.grad is not None and (x.grad[:, 2] == 0).all() and (x.grad[:, [0, 1, 3, 4, 5]] != 0).any()
    )


def test_missing_and_scaled_inputs_are_zeros_and_factors() -> None:
    torch.manual_seed(0)
    network = Network(NETWORKS["relu"]())
    x, scale = torch.randn(10, 4), torch.tensor([1.0, 1.0, 1.0, 0.5, 0.0, 0.0])
    whole = torch.cat([x * scale[:4], torch.zeros(10, 2)], dim=1)
    torch.testing.assert_close(network(x, scale), network(whole))
    torch.testing.assert_close(network(x, scale, plain=True), network(whole))


def test_no_input_features_at_all() -> None:
    network = Network(NETWORKS["relu"]())
    out = network(torch.empty(5, 0), torch.zeros(6))
    assert torch.equal(out, torch.zeros(5, 3))  # no bias: zero in, zero out
    out.sum().backward()


def test_a_layer_that_is_not_affine_runs_through_autograd() -> None:
    torch.manual_seed(0)
    stranger = Stranger(16, 3)
    network = Network([Linear(6, 16, "relu"), stranger])
    x = torch.randn(7, 6)
    expected = torch.sin(
        torch.relu(x @ network.layers[0].weight.T) @ stranger.inner.weight.T + stranger.inner.bias
    )
    torch.testing.assert_close(network(x), expected)
    network(x).sum().backward()
    assert stranger.inner.weight.grad is not None


def test_a_layer_may_be_affine_only_at_times() -> None:
    class Sometimes(Linear):
        shift: Tensor | None = None

        def effective(self) -> tuple[Tensor, None] | None:
            return None if self.shift is not None else super().effective()

        def forward(self, x: Tensor) -> Tensor:
            assert self.shift is not None
            return x @ self.weight.T + self.shift

    layer = Sometimes(6, 3)
    network, x = Network([layer]), torch.randn(5, 6)
    before = network(x)
    layer.shift = torch.ones(5, 3)
    torch.testing.assert_close(network(x), before + 1)


def test_gelu_after_the_last_layer_is_fused_too() -> None:
    torch.manual_seed(0)
    network = Network(NETWORKS["gelu at the end"]())
    x = torch.randn(9, 6, requires_grad=True)
    torch.testing.assert_close(network(x), network(x, plain=True))
    gradients = [
        torch.autograd.grad(network(x, plain=plain).sum(), x)[0] for plain in (True, False)
    ]
    torch.testing.assert_close(gradients[1], gradients[0])


class Shifted(Linear):
    """Adds something to its input and output, point by point."""

    before: Tensor | None = None
    after: Tensor | None = None

    def input_shift(self) -> Tensor | None:
        return self.before

    def output_shift(self) -> Tensor | None:
        return self.after


@pytest.mark.parametrize("scale", [None, torch.tensor([1.0, 1.0, 0.5, 0.0, 0.0, 0.0])])
def test_shifts_of_the_first_input_and_the_last_output(scale: Tensor | None) -> None:
    """Both paths compute W2 relu(W1 (x * scale + before)) + after, and gradients by the shifts."""
    torch.manual_seed(0)
    first, last = Shifted(6, 8, "relu"), Shifted(8, 3)
    first.before, last.after = (
        torch.randn(9, 6, requires_grad=True),
        torch.randn(9, 3, requires_grad=True),
    )
    network, x = Network([first, last]), torch.randn(9, 6)
    assert network._affine() is not None, "shifts must not leave the fused path"
    hidden = (x if scale is None else x * scale) + first.before
    expected = (hidden @ first.weight.T).relu() @ last.weight.T + last.after
    narrow = x if scale is None else x[:, :3]  # the features beyond are dead and never evaluated
    for plain in (True, False):
        made = network(narrow, scale, plain=plain)
        torch.testing.assert_close(made, expected)
        for got, wanted in zip(
            _grads(made, first, last), _grads(expected, first, last), strict=True
        ):
            torch.testing.assert_close(got, wanted)


def test_a_shifted_first_layer_does_not_see_the_gap() -> None:
    torch.manual_seed(0)
    first, last = Shifted(5, 8, "relu"), Linear(8, 3)
    first.before = torch.randn(9, 5)
    network, x = Network([first, last]), torch.randn(9, 6)
    torch.testing.assert_close(network(x, gap=2), network(x, gap=2, plain=True))


@pytest.mark.parametrize("where", ["input", "output"])
def test_shifts_in_between_leave_the_fused_path(where: str) -> None:
    torch.manual_seed(0)
    layers = [Shifted(6, 8, "relu"), Shifted(8, 3)]
    if where == "input":
        layers[1].before = torch.ones(4, 8)
    else:
        layers[0].after = torch.ones(4, 8)
    x = torch.randn(4, 6)
    # Adding 1 behind the first layer, or before the second, is the same.
    expected = ((x @ layers[0].weight.T).relu() + 1) @ layers[1].weight.T
    torch.testing.assert_close(Network([*layers])(x), expected)


@pytest.mark.parametrize("name", ["relu", "gelu", "mixed"])
def test_bfloat16_is_as_near_as_its_eight_bits_allow(name: str) -> None:
    """The fused network in bfloat16 agrees with float32 to the errors of its roundings.

    Each rounding errs by at most 2^-9, and a handful of them are between input and output. In the
    backward pass a unit whose input is within 2^-9 of 0 (one in about 400) may also be on where it
    was off, with all of its gradient: the root of 1/400 is 5 %.
    """
    torch.manual_seed(0)
    network = Network(NETWORKS[name]())
    x = torch.randn(CHUNK + 3, 6)
    upstream = torch.randn(CHUNK + 3, 3)
    results = []
    for precision in (torch.float32, torch.bfloat16):
        network.precision = precision
        network.zero_grad(set_to_none=True)
        inputs = x.clone().requires_grad_()
        out = network(inputs)
        out.backward(upstream)
        made = [out.detach(), inputs.grad, *(p.grad for p in network.parameters())]
        assert all(tensor.dtype == torch.float32 for tensor in made)
        results.append(made)
    errors = [
        float((rounded - exact).norm() / exact.norm())
        for exact, rounded in zip(*results, strict=True)
    ]
    assert 0 < errors[0] < 8 * 2**-9
    assert max(errors[1:]) < 0.08


def test_a_network_of_one_layer_and_a_double_one_round_nothing() -> None:
    x = torch.randn(7, 6)
    one = NETWORKS["one layer"]()
    torch.testing.assert_close(Network(one, torch.bfloat16)(x), Network(one)(x), rtol=0, atol=0)
    double = Network(NETWORKS["relu"](), torch.bfloat16).double()
    torch.testing.assert_close(
        double(x.double()), double(x.double(), plain=True), rtol=1e-14, atol=1e-14
    )


def test_frozen_weights_get_no_gradient_and_the_input_does() -> None:
    network = Network(NETWORKS["relu"]())
    wanted, x = torch.randn(5, 6, requires_grad=True), torch.randn(5, 6)
    [expected] = torch.autograd.grad(network(wanted + x).sum(), [wanted])
    network.requires_grad_(False)
    out = network(wanted + x)
    network.requires_grad_(True)
    out.sum().backward()
    torch.testing.assert_close(wanted.grad, expected)
    assert all(parameter.grad is None for parameter in network.parameters())


def _grads(made: Tensor, first: Shifted, last: Shifted) -> tuple[Tensor, ...]:
    return torch.autograd.grad(
        made.square().sum(),
        [first.before, last.after, first.weight, last.weight],
        retain_graph=True,
    )
