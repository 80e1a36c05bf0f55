"""Layers that tell what they compute, so that the fused kernels can run them."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

ACTIVATIONS = {"none": lambda x: x, "relu": functional.relu, "gelu": functional.gelu}


class AffineLayer(nn.Module):
    """An affine map followed by an elementwise activation: y = activation(x W^T + b).

    A subclass says what W and b are at the moment. The fused kernels take those, and autograd carries the gradient on
    from W and b to whatever they were made of.

    activation: "none", "relu" or "gelu" (the exact one, with erf).
    """

    def __init__(self, activation: str) -> None:
        super().__init__()
        self.activation = activation

    def effective(self) -> tuple[Float[Tensor, "out in"], Float[Tensor, " out"] | None] | None:
        """Weight and bias to use now; None where the layer is not affine this time, then `forward` runs instead."""
        raise NotImplementedError

    def input_shift(self) -> Float[Tensor, "points in"] | None:
        """What is added to the input now, point by point; only the first layer of a network may have one."""
        return None

    def output_shift(self) -> Float[Tensor, "points out"] | None:
        """What is added to the output now, point by point; only the last layer of a network may have one."""
        return None

    def forward(self, x: Float[Tensor, "points in"]) -> Float[Tensor, "points out"]:
        """The plain version of what the fused kernels compute."""
        affine = self.effective()
        assert affine is not None, "a layer that is not always affine overrides forward"
        return shifted(
            ACTIVATIONS[self.activation](
                functional.linear(shifted(x, self.input_shift()), *affine)
            ),
            self.output_shift(),
        )


class Linear(AffineLayer):
    """A linear layer without bias, initialised as torch does (uniform, 1/sqrt(in))."""

    def __init__(self, in_features: int, out_features: int, activation: str = "none") -> None:
        super().__init__(activation)
        self.weight = nn.Linear(in_features, out_features, bias=False).weight

    def effective(self) -> tuple[Float[Tensor, "out in"], None]:
        return self.weight, None


def shifted(x: Tensor, shift: Tensor | None) -> Tensor:
    return x if shift is None else x + shift
