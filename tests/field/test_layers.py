"""Layers around layers: the plain path computes what the fused kernels do."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from nerfreg.field.layers import Linear, WrappedLayer
from nerfreg.field.network import Network


class Doubled(WrappedLayer):
    """Twice the weight, and shifts of 1 before it and 3 behind it."""

    def effective(self) -> tuple[Tensor, Tensor | None] | None:
        affine = super().effective()
        return None if affine is None else (2 * affine[0], affine[1])

    def added_input(self) -> Tensor:
        return torch.ones(5, 3)

    def added_output(self) -> Tensor:
        return torch.full((5, 2), 3.0)


def test_weights_and_shifts_of_a_wrapper_are_the_same_on_both_paths() -> None:
    inner = Linear(3, 2)
    layer, x = Doubled(inner), torch.rand(5, 3)
    expected = 2 * (x + 1) @ inner.weight.T + 3
    assert torch.allclose(layer(x), expected)
    network = Network([layer], torch.float32)
    for plain in (False, True):
        assert torch.allclose(network(x, plain=plain), expected, atol=1e-6)


@pytest.mark.parametrize("inner", [nn.Tanh(), nn.Identity()])
def test_a_layer_that_is_not_affine_is_applied_between_the_shifts(inner: nn.Module) -> None:
    x = torch.rand(5, 2)

    class Shifted(WrappedLayer):
        def added_input(self) -> Tensor:
            return torch.ones(5, 2)

        def added_output(self) -> Tensor:
            return torch.full((5, 2), 3.0)

    assert torch.equal(Shifted(inner)(x), inner(x + 1) + 3)
