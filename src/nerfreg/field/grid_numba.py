"""The hash grid on the CPU: the compiled kernels as the same functions as in `grid_torch`.

All derivatives of the grid are those of one number: the sum over points and features of feature
times incoming gradient. It is linear in the table and in the incoming gradient, so `_Encode`,
`_Gradient` and `_Scatter`, its derivatives by the incoming gradient, the positions and the table,
are each other's backward passes. Only the second derivatives by the positions need kernels of their
own. Within these operations positions are `(3, P)` and features `(2 * levels, P)`, so that loads
and stores of consecutive points are contiguous.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numba import get_num_threads
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.field import grid_kernels, grid_kernels_second
from nerfreg.field.grid_layout import FEATURES, GridLayout
from nerfreg.field.grid_shared import SharedTable, apply, wanted


def encode(
    positions: Float[Tensor, "points 3"],
    table: Float[Tensor, "entries 2"] | SharedTable,
    layout: GridLayout,
    levels: int,
) -> Float[Tensor, "points features"]:
    """Interpolate the features of the coarsest levels, as `grid_torch.encode` does.

    Args:
        positions: Positions in the unit cube, `(P, 3)`, float32 on the CPU.
        table: The features of all levels, `(E, 2)`, float32 on the CPU, or such a table shared
            with other operations.
        layout: Resolutions of the levels and their places in the table.
        levels: Number of levels to evaluate, from the coarsest.

    Returns:
        The features, `(P, 2 * levels)`, stored feature by feature (column-major). They are
        differentiable twice.
    """
    shared = table if isinstance(table, SharedTable) else SharedTable(table)
    rows = positions.t().contiguous()
    features = apply(_Encode, rows, shared.table, shared, layout, levels)
    # A view: the matrix products of the network take either layout, so nothing is copied.
    return features.t()


def gradient(
    positions: Float[Tensor, "points 3"],
    grad: Float[Tensor, "points features"],
    table: Float[Tensor, "entries 2"] | SharedTable,
    layout: GridLayout,
) -> Float[Tensor, "points 3"]:
    """Take a gradient by the features to the positions, as `grid_torch.gradient` does.

    Args:
        positions: Positions in the unit cube, `(P, 3)`, float32 on the CPU.
        grad: Gradient by the features of the coarsest levels, `(P, 2 * levels)`.
        table: The features of all levels, `(E, 2)`, float32 on the CPU, or such a table shared
            with other operations.
        layout: Resolutions of the levels and their places in the table.

    Returns:
        The gradient by the positions, `(P, 3)`. It is differentiable once, by all three tensors.
    """
    shared = table if isinstance(table, SharedTable) else SharedTable(table)
    rows, grads = positions.t().contiguous(), grad.t().contiguous()
    return apply(_Gradient, rows, grads, shared.table, shared, layout).t()


class _Encode(torch.autograd.Function):
    """The features at positions."""

    @staticmethod
    def forward(
        ctx: Any,
        positions: Tensor,
        table: Tensor,
        shared: SharedTable,
        layout: GridLayout,
        levels: int,
    ) -> Tensor:
        points = positions.shape[1]
        features = torch.empty(FEATURES * levels, points)
        encoded = _array(positions), _pairs(table), *_arguments(layout)
        if get_num_threads() == 1:
            # Not every threading layer of numba may be entered by several threads at once, as
            # `in_shares` would do. Its workers have one numba thread each and come here.
            grid_kernels.forward_share(*encoded, features.numpy(), 0, points)
        else:
            grid_kernels.forward(*encoded, get_num_threads(), features.numpy())
        ctx.save_for_backward(positions, table)
        ctx.shared, ctx.layout = shared, layout
        return features

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        positions, table = ctx.saved_tensors
        grad = grads[0].contiguous()
        position_grad = table_grad = None
        if wanted(ctx, 1) and torch.is_grad_enabled():
            table_grad = apply(_Scatter, positions, grad, len(table), ctx.layout)
        elif wanted(ctx, 1):
            buffer, new = ctx.shared.buffer()
            _scatter(positions, grad, ctx.layout, buffer)
            table_grad = buffer if new else None
        if wanted(ctx, 0):
            position_grad = apply(_Gradient, positions, grad, table, ctx.shared, ctx.layout)
        return position_grad, table_grad, None, None, None


class _Scatter(torch.autograd.Function):
    """The gradient by the table, where it is going to be differentiated."""

    @staticmethod
    def forward(
        ctx: Any, positions: Tensor, grad: Tensor, entries: int, layout: GridLayout
    ) -> Tensor:
        ctx.save_for_backward(positions, grad)
        ctx.layout = layout
        table_grad = torch.zeros(entries, FEATURES)
        _scatter(positions, grad, layout, table_grad)
        return table_grad

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        positions, grad = ctx.saved_tensors
        # What arrives has the shape of the table and takes its place.
        shared = SharedTable(grads[0].contiguous())
        position_grad = grad_grad = None
        if wanted(ctx, 0):
            position_grad = apply(_Gradient, positions, grad, shared.table, shared, ctx.layout)
        if wanted(ctx, 1):
            levels = len(grad) // FEATURES
            grad_grad = apply(_Encode, positions, shared.table, shared, ctx.layout, levels)
        return position_grad, grad_grad, None, None


class _Gradient(torch.autograd.Function):
    """The gradient by the positions."""

    @staticmethod
    def forward(
        ctx: Any,
        positions: Tensor,
        grad: Tensor,
        table: Tensor,
        shared: SharedTable,
        layout: GridLayout,
    ) -> Tensor:
        position_grad = torch.zeros(positions.shape)
        grid_kernels.backward_positions(
            _array(positions),
            _pairs(table),
            _array(grad),
            *_arguments(layout),
            get_num_threads(),
            position_grad.numpy(),
        )
        ctx.save_for_backward(positions, grad, table)
        ctx.shared, ctx.layout = shared, layout
        return position_grad

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        positions, grad, table = ctx.saved_tensors
        along = grads[0].contiguous()
        at, entries = _array(positions), _pairs(table)
        arguments = _array(along), *_arguments(ctx.layout), get_num_threads()
        position_grad = grad_grad = table_grad = None
        if wanted(ctx, 0):
            position_grad = torch.zeros(positions.shape)
            grid_kernels_second.directional_positions(
                at, entries, _array(grad), *arguments, position_grad.numpy()
            )
        if wanted(ctx, 1):
            grad_grad = torch.empty(grad.shape)
            grid_kernels_second.directional(at, entries, *arguments, grad_grad.numpy())
        if wanted(ctx, 2):
            recorded = torch.is_grad_enabled()
            buffer, new = (torch.zeros(table.shape), True) if recorded else ctx.shared.buffer()
            grid_kernels_second.directional_table(at, _array(grad), *arguments, _pairs(buffer))
            table_grad = buffer if new else None
        results = [position_grad, grad_grad, table_grad]
        if torch.is_grad_enabled():
            sources = along, positions, grad, table
            results = [r if r is None else apply(_Last, r, *sources) for r in results]
        return *results, None, None


class _Last(torch.autograd.Function):
    """The identity, which refuses to be differentiated by what its first argument is made of."""

    @staticmethod
    def forward(ctx: Any, result: Tensor, *sources: Tensor) -> Tensor:
        return result.view_as(result)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, ...]:
        raise NerfregError(
            "the compiled hash grid can be differentiated twice but not three times; "
            "set field.backend=torch"
        )


def _scatter(positions: Tensor, grad: Tensor, layout: GridLayout, table_grad: Tensor) -> None:
    # Levels that were not evaluated have no rows in `grad`; nothing is added to them.
    grid_kernels.backward_table(
        _array(positions),
        _array(grad),
        *_arguments(layout),
        get_num_threads(),
        _pairs(table_grad),
    )


def _array(values: Tensor) -> np.ndarray:
    return values.detach().numpy()


def _pairs(table: Tensor) -> np.ndarray:
    """View the two features of each entry as one complex number, `(E,)`, in the same memory."""
    return _array(table).view(np.complex64)[:, 0]


def _arguments(layout: GridLayout) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.int32]:
    # Plain arrays and numbers, since compiled code knows no dataclass.
    return layout.offsets, layout.resolutions, layout.dense, np.int32(2**layout.log2_entries - 1)
