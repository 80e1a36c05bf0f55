"""A small network of layers made by the layer factory, with fused kernels for affine layers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from nerfreg.field.layers import ACTIVATIONS, AffineLayer, shifted
from nerfreg.field.workers import in_shares

CHUNK = 4096
"""Points per chunk: the activations of a layer 64 wide take 1 MB, about the second-level cache of a
core. Chunks of 1024 to 8192 points are equally fast within 5 %."""


class Network(nn.Module):
    """Layers one after the other; each applies its own activation.

    Attributes:
        layers: The layers, from the input to the output.
        precision: The type in which the fused path computes all layers but the last. The plain path
            keeps the type of the input.
    """

    def __init__(self, layers: list[nn.Module], precision: torch.dtype = torch.float32) -> None:
        """Take over the layers."""
        super().__init__()
        self.layers = nn.ModuleList(layers)
        self.precision = precision

    def forward(
        self,
        x: Float[Tensor, "points in"],
        scale: Float[Tensor, " all"] | None = None,
        gap: int | None = None,
        plain: bool = False,
    ) -> Float[Tensor, "points out"]:
        """Evaluate the network.

        Args:
            x: The inputs, `(P, in)`. They may be narrower than the first layer; the missing
                features count as 0 and cost nothing.
            scale: A factor for each input feature of the first layer.
            gap: A column of `x` that the first layer does not have and that is ignored.
            plain: Whether to use autograd even where the fused path could run. Other devices than
                the CPU always do.

        Returns:
            The outputs, `(P, out)`.
        """
        affine = None if plain or x.device.type != "cpu" else self._affine()
        if affine is None:
            return self._plain(_without(x, gap), scale)
        first, last = self.layers[0], self.layers[-1]
        assert isinstance(first, AffineLayer) and isinstance(last, AffineLayer)
        # Gap, missing features and scale all become part of the first weight, which has a few
        # thousand numbers, instead of copies of x, which has millions. Autograd takes the gradient
        # back through the same steps.
        weights = list(affine)
        if (shift := first.input_shift()) is not None:
            # A shift applies to what the layer sees, after scaling, and in all its columns: then x
            # has to be made after all.
            x, scale, gap = _scaled(_without(x, gap), scale) + shift, None, None
        if gap is not None:
            known = weights[0]
            weights[0] = torch.cat(
                [known[:, :gap], known.new_zeros(len(known), 1), known[:, gap:]], dim=1
            )
        used = weights[0][:, : x.shape[1]]
        weights[0] = used if scale is None else used * scale[: x.shape[1]]
        activations = tuple(layer.activation for layer in self.layers)
        return shifted(
            _FusedNetwork.apply(x, activations, self._precision(x), *weights), last.output_shift()
        )

    def _affine(self) -> list[Any] | None:
        """Weight and bias of every layer in turn; None where the fused kernels cannot run.

        They cannot if a layer is not affine now, if the last layer has an activation, or if
        something is added between two layers.
        """
        # The backward pass takes the gradient of the output for that of the last affine map.
        if getattr(self.layers[-1], "activation", "none") != "none":
            return None
        parts: list[Any] = []
        for layer in self.layers:
            if not isinstance(layer, AffineLayer) or _shifts_inside(self.layers, layer):
                return None
            effective = layer.effective()
            if effective is None:
                return None
            parts.extend(effective)
        return parts

    def _precision(self, x: Tensor) -> torch.dtype:
        # Only float32 is lowered: a network that is checked in float64 must stay there.
        return self.precision if x.dtype == torch.float32 else x.dtype

    def _plain(self, x: Tensor, scale: Tensor | None) -> Tensor:
        x = _scaled(x, scale)
        for layer in self.layers:
            x = layer(x)
        return x


def _shifts_inside(layers: nn.ModuleList, layer: AffineLayer) -> bool:
    """Whether the layer adds something in between, neither at the input nor at the output."""
    before = layer is not layers[0] and layer.input_shift() is not None
    return before or (layer is not layers[-1] and layer.output_shift() is not None)


def _without(x: Tensor, column: int | None) -> Tensor:
    return x if column is None else torch.cat([x[:, :column], x[:, column + 1 :]], dim=1)


def _scaled(x: Tensor, scale: Tensor | None) -> Tensor:
    """The features times their factors, with zeros for those that are missing."""
    return (
        x
        if scale is None
        else functional.pad(x * scale[: x.shape[1]], (0, len(scale) - x.shape[1]))
    )


class _FusedNetwork(torch.autograd.Function):
    """All layers over one chunk of points after the other, forward and backward.

    Autograd would take each layer over all points, so that every activation travels to memory and
    back; a chunk goes through all layers while its activations are in the cache.

    One tensor is kept per hidden layer. For a ReLU it is the layer's output, which tells where the
    gradient passes and is the input of the next layer at the same time. For the other activations
    it is what went into the activation, and the output is computed again. All layers but the last
    compute in `precision`; the last one, and all sums over points, in the type of x.
    """

    @staticmethod
    def forward(
        ctx: Any,
        x: Tensor,
        activations: tuple[str, ...],
        precision: torch.dtype,
        *parameters: Tensor | None,
    ) -> Tensor:
        layers = _layers(activations, parameters, precision)
        # Views are rendered without gradients and keep nothing: a thread reuses buffers of one
        # chunk.
        training = any(ctx.needs_input_grad)
        kept = [_empty(len(x), layer) for layer in layers[:-1]] if training else []
        output = x.new_empty(len(x), len(layers[-1].weight))

        def run(first: int, last: int) -> None:
            buffers = [] if training else [_empty(CHUNK, layer) for layer in layers[:-1]]
            for start in range(first, last, CHUNK):
                stop = min(start + CHUNK, last)
                rows = (
                    [k[start:stop] for k in kept]
                    if training
                    else [b[: stop - start] for b in buffers]
                )
                hidden = x[start:stop]
                for layer, out in zip(layers, [*rows, output[start:stop]], strict=True):
                    hidden = layer.forward(hidden, out)

        in_shares(len(x), CHUNK, run)
        ctx.activations, ctx.precision = activations, precision
        ctx.save_for_backward(x, *parameters, *kept)
        return output

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        count = len(ctx.activations)
        x, *rest = ctx.saved_tensors
        parameters, kept = rest[: 2 * count], rest[2 * count :]
        layers = _layers(ctx.activations, parameters, ctx.precision)
        x_grad = torch.empty_like(x) if ctx.needs_input_grad[0] else None

        # Frozen weights get no sums: a search over inputs alone would pay for them and throw them
        # away.
        def zeros() -> list[Tensor | None]:
            wanted = zip(parameters, ctx.needs_input_grad[3:], strict=True)
            return [torch.zeros_like(parameter) if needed else None for parameter, needed in wanted]

        def run(first: int, last: int) -> list[Tensor | None]:
            # Sums of this thread's own: threads must not add to the same weights at once.
            sums = zeros()
            buffers = [layer.weight.new_empty(CHUNK, layer.weight.shape[1]) for layer in layers]
            for start in range(first, last, CHUNK):
                stop = min(start + CHUNK, last)
                # `grad` is always the gradient of what went into the activation of layer i; the
                # last layer has none.
                grad = grads[0][start:stop]
                for i in range(count - 1, -1, -1):
                    # What layer i saw: the input of the network, or what was kept of the layer
                    # below, through that layer's activation.
                    before = kept[i - 1][start:stop] if i else x[start:stop]
                    activation = layers[i - 1].activation if i else "none"
                    # Before the gradient moves on to the layer below: both need it as it is now.
                    layers[i].add_parameter_grads(sums[2 * i : 2 * i + 2], grad, before, activation)
                    if i:
                        grad = layers[i].backward(
                            grad, buffers[i][: stop - start], before, activation
                        )
                    elif x_grad is not None:
                        # Through a buffer, since the layer may compute in another type than that of
                        # x; the assignment converts.
                        x_grad[start:stop] = torch.mm(
                            grad, layers[0].weight, out=buffers[0][: stop - start]
                        )
            return sums

        # The shares are added in their order, so that a run is repeatable for a number of threads.
        shares = in_shares(len(x), CHUNK, run)
        totals = zeros()
        for sums in shares:
            for total, part in zip(totals, sums, strict=True):
                if total is not None and part is not None:
                    total += part
        return x_grad, None, None, *totals


class _Layer(NamedTuple):
    """An affine layer, its weight and bias in the type in which it computes."""

    weight: Tensor
    bias: Tensor | None
    activation: str

    def forward(self, x: Tensor, out: Tensor) -> Tensor:
        """Activation of x W^T + b; `out` holds it for a ReLU, else what went into it."""
        # Returns x itself where the type is right already.
        x = x.to(self.weight.dtype)
        if self.bias is None:
            torch.mm(x, self.weight.t(), out=out)
        else:
            torch.addmm(self.bias, x, self.weight.t(), out=out)
        return out.relu_() if self.activation == "relu" else ACTIVATIONS[self.activation](out)

    def backward(self, grad: Tensor, out: Tensor, before: Tensor, activation: str) -> Tensor:
        """Gradient of what went into the activation of the layer below, in the type of that layer.

        `before` is what was kept of the layer below, `activation` its activation.
        """
        grad = torch.mm(grad, self.weight, out=out).to(before.dtype)
        # In place, by torch's own backward kernels: masks and products would be temporaries. ReLU's
        # may look at the output, which is positive exactly where the input was.
        if activation == "relu":
            torch.ops.aten.threshold_backward.grad_input(grad, before, 0, grad_input=grad)
        elif activation == "gelu":
            torch.ops.aten.gelu_backward.grad_input(grad, before, grad_input=grad)
        return grad

    def add_parameter_grads(
        self, sums: Sequence[Tensor | None], grad: Tensor, before: Tensor, activation: str
    ) -> None:
        """Add the sums over the points of a chunk to `sums`, weight and bias of this layer.

        `before` is what was kept of the layer below, `activation` its activation.
        """
        weight, bias = sums
        if weight is not None:
            x = (functional.gelu(before) if activation == "gelu" else before).to(grad.dtype)
            # Product and sum are one operation where the types agree. Otherwise only the product
            # over a chunk is in bfloat16; the sum over chunks stays in float32, or it would stop
            # growing.
            if weight.dtype == grad.dtype:
                weight.addmm_(grad.t(), x)
            else:
                weight += grad.t() @ x
        if bias is not None:
            bias += grad.sum(dim=0, dtype=bias.dtype)


def _layers(
    activations: tuple[str, ...], parameters: Sequence[Tensor | None], precision: torch.dtype
) -> list[_Layer]:
    weights = [weight for weight in parameters[::2] if weight is not None]
    *hidden, last = [
        _Layer(*parts) for parts in zip(weights, parameters[1::2], activations, strict=True)
    ]
    return [*(_rounded(layer, precision) for layer in hidden), last]


def _rounded(layer: _Layer, precision: torch.dtype) -> _Layer:
    bias = None if layer.bias is None else layer.bias.to(precision)
    return _Layer(layer.weight.to(precision), bias, layer.activation)


def _empty(points: int, layer: _Layer) -> Tensor:
    return layer.weight.new_empty(points, len(layer.weight))
