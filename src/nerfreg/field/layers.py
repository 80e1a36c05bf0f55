"""Layers that expose what they compute, so that the fused kernels can run them."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

ACTIVATIONS = {"none": lambda x: x, "relu": functional.relu, "gelu": functional.gelu}
"""Activations that the fused kernels know."""


class AffineLayer(nn.Module):
    """An affine map followed by an elementwise activation: y = activation(x W^T + b).

    A subclass defines the current W and b. The fused kernels use those, and autograd carries the
    gradient on from W and b to whatever they were computed from.

    Attributes:
        activation: "none", "relu" or "gelu" (the exact one, with erf).
    """

    def __init__(self, activation: str) -> None:
        """Set the activation."""
        super().__init__()
        self.activation = activation

    def effective(self) -> tuple[Float[Tensor, "out in"], Float[Tensor, " out"] | None] | None:
        """Compute the weight and bias to use now.

        Returns:
            The weight and the bias, if there is one; None if the layer is not affine this time, in
            which case `forward` runs instead of the fused kernels.
        """
        raise NotImplementedError

    def input_shift(self) -> Float[Tensor, "points in"] | None:
        """Return what to add to the input, point by point, or None.

        Only the first layer of a network stays in the fused kernels with such a shift.
        """
        return None

    def output_shift(self) -> Float[Tensor, "points out"] | None:
        """Return what to add to the output, point by point, or None.

        Only the last layer of a network stays in the fused kernels with such a shift.
        """
        return None

    def forward(self, x: Float[Tensor, "points in"]) -> Float[Tensor, "points out"]:
        """Compute by plain autograd what the fused kernels compute."""
        affine = self.effective()
        assert affine is not None, "a layer that is not always affine overrides forward"
        return shifted(
            ACTIVATIONS[self.activation](
                functional.linear(shifted(x, self.input_shift()), *affine)
            ),
            self.output_shift(),
        )


class WrappedLayer(AffineLayer):
    """A layer around another one, which stays in the fused kernels where the inner one does.

    A subclass overrides what it changes: `effective` for weight and bias, `added_input` and
    `added_output` for what is added point by point. Where `effective` returns None, because the
    layer inside is not affine, `forward` applies that layer between the two.

    Attributes:
        inner: The layer inside.
        activation: That of the layer inside; "none" if it has none that is known.
    """

    def __init__(self, inner: nn.Module) -> None:
        """Wrap a layer."""
        super().__init__(getattr(inner, "activation", "none"))
        self.inner = inner

    def added_input(self) -> Float[Tensor, "points in"] | None:
        """Return what this layer adds to the input, point by point, or None."""
        return None

    def added_output(self) -> Float[Tensor, "points out"] | None:
        """Return what this layer adds to the output, point by point, or None."""
        return None

    def effective(self) -> tuple[Float[Tensor, "out in"], Float[Tensor, " out"] | None] | None:
        """Return weight and bias of the layer inside; None if it is not affine."""
        return self.inner.effective() if isinstance(self.inner, AffineLayer) else None

    def input_shift(self) -> Float[Tensor, "points in"] | None:
        """Return what this layer and those inside add to the input."""
        inner = self.inner.input_shift() if isinstance(self.inner, AffineLayer) else None
        own = self.added_input()
        return own if inner is None else shifted(inner, own)

    def output_shift(self) -> Float[Tensor, "points out"] | None:
        """Return what this layer and those inside add to the output."""
        inner = self.inner.output_shift() if isinstance(self.inner, AffineLayer) else None
        own = self.added_output()
        return own if inner is None else shifted(inner, own)

    def forward(self, x: Float[Tensor, "points in"]) -> Float[Tensor, "points out"]:
        """Compute by plain autograd what the fused kernels compute."""
        if self.effective() is not None:
            return super().forward(x)
        return shifted(self.inner(shifted(x, self.added_input())), self.added_output())


class Linear(AffineLayer):
    """A linear layer without bias, initialized as torch does: uniform within 1/sqrt(in)."""

    def __init__(self, in_features: int, out_features: int, activation: str = "none") -> None:
        """Draw the weight from torch's global random generator."""
        super().__init__(activation)
        self.weight = nn.Linear(in_features, out_features, bias=False).weight

    def effective(self) -> tuple[Float[Tensor, "out in"], None]:
        """Return the weight itself, and no bias."""
        return self.weight, None


def shifted(x: Tensor, shift: Tensor | None) -> Tensor:
    """Add a shift, if there is one."""
    return x if shift is None else x + shift
