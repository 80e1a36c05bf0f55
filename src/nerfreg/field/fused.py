"""Affine layers fused over chunks of points that fit the cache, with their own backward pass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from nerfreg.field.layers import ACTIVATIONS
from nerfreg.field.workers import in_shares

CHUNK = 4096
"""Points per chunk: the activations of a layer 64 wide take 1 MB, about the second-level cache of a
core. Chunks of 1024 to 8192 points are equally fast within 5 %."""


class FusedNetwork(torch.autograd.Function):
    """All layers over one chunk of points after the other, forward and backward.

    Autograd would take each layer over all points, so that every activation travels to memory and
    back; a chunk goes through all layers while its activations are in the cache.

    One tensor is kept per hidden layer. For a ReLU it is the layer's output, which tells where the
    gradient passes and is the input of the next layer at the same time. For the other activations
    it is what went into the activation, and the output is computed again. All layers but the last
    compute in `precision`; the last one computes, and all weight gradients are summed over chunks,
    in the type of x.
    """

    @staticmethod
    def forward(
        ctx: Any,
        x: Tensor,
        activations: tuple[str, ...],
        precision: torch.dtype,
        *parameters: Tensor | None,
    ) -> Tensor:
        """Evaluate the layers.

        Args:
            ctx: Autograd's context.
            x: The inputs, `(P, in)`.
            activations: The activation of each layer; the last one has none.
            precision: The type in which all layers but the last compute.
            parameters: Weight and bias (or None) of each layer in turn.

        Returns:
            The outputs, `(P, out)`.
        """
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
        """Compute the gradients by the inputs and by the parameters that need one."""
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
