"""The hash grid on the CPU: the compiled kernels as the same function as `grid_torch.encode`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numba import get_num_threads
from torch import Tensor

from nerfreg.field import grid_kernels
from nerfreg.field.grid_layout import FEATURES, GridLayout


class SharedTable:
    """The table as several encodings see it whose gradients are added up in one buffer.

    Autograd gets the buffer from the first encoding of a backward pass, while later ones still add
    to it. Therefore nothing but encodings may use `table`: autograd would add the gradient of
    another use to the buffer out of place, and what encodings add afterwards would be lost.

    Attributes:
        table: The table, behind a node of the graph that all encodings share. The node runs when
            all of them are done, and only then hands the finished buffer on.
    """

    def __init__(self, table: Float[Tensor, "entries 2"]) -> None:
        """Put the shared node on top of the table."""
        self._buffer: Tensor | None = None
        apply: Callable[..., Tensor] = _Share.apply
        self.table = apply(table, self)

    def buffer(self) -> tuple[Tensor, bool]:
        """Return the buffer of this backward pass, and whether it is new.

        The encoding that gets a new buffer must return it to autograd, and it alone: the others
        would make autograd add the buffer to itself.
        """
        if self._buffer is not None:
            return self._buffer, False
        self._buffer = torch.zeros(self.table.shape)
        # A pass that asks for other gradients only (torch.autograd.grad) never reaches `_Share`,
        # and the next pass must not go on adding to its buffer.
        torch.autograd.Variable._execution_engine.queue_callback(self.forget)
        return self._buffer, True

    def forget(self) -> None:
        """Let go of the buffer, so that the next backward pass starts with a new one."""
        self._buffer = None


class _Share(torch.autograd.Function):
    """The identity, whose backward pass marks the end of all encodings' additions."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, shared: SharedTable) -> Tensor:
        ctx.shared = shared
        # A new tensor: an input returned as it is would not get a node of its own.
        return table.view_as(table)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        ctx.shared.forget()
        return grads[0], None


class _Encode(torch.autograd.Function):
    """The kernels as an operation of autograd, by both the positions and the table."""

    @staticmethod
    def forward(
        ctx: Any,
        positions: Tensor,
        table: Tensor,
        layout: GridLayout,
        levels: int,
        shared: SharedTable | None,
    ) -> Tensor:
        features = torch.empty(FEATURES * levels, len(positions))
        # One row per coordinate: loads of consecutive points are then contiguous.
        rows = positions.detach().t().contiguous()
        encoded = rows.numpy(), _pairs(table), *_arguments(layout)
        if get_num_threads() == 1:
            # Not every threading layer of numba may be entered by several threads at once, as
            # `in_shares` would do. Its workers have one numba thread each and come here.
            grid_kernels.forward_share(*encoded, features.numpy(), 0, len(positions))
        else:
            grid_kernels.forward(*encoded, get_num_threads(), features.numpy())
        ctx.save_for_backward(rows, table)
        ctx.layout, ctx.shared = layout, shared
        # A view: the matrix products of the network take either layout, so nothing is copied.
        return features.t()

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        rows, table = ctx.saved_tensors
        positions, grad = rows.numpy(), grads[0].t().contiguous().numpy()
        arguments = *_arguments(ctx.layout), get_num_threads()
        table_grad = position_grad = None
        if ctx.needs_input_grad[1]:
            buffer, new = (
                (torch.zeros(table.shape), True) if ctx.shared is None else ctx.shared.buffer()
            )
            # Levels that were not evaluated have no rows in `grad` and stay zero in the buffer.
            grid_kernels.backward_table(positions, grad, *arguments, _pairs(buffer))
            table_grad = buffer if new else None
        if ctx.needs_input_grad[0]:
            position_grad = torch.zeros(rows.shape)
            grid_kernels.backward_positions(
                positions, _pairs(table), grad, *arguments, position_grad.numpy()
            )
            position_grad = position_grad.t()
        return position_grad, table_grad, None, None, None


def _pairs(table: Tensor) -> np.ndarray:
    """View the two features of each entry as one complex number, `(E,)`, in the same memory."""
    return table.detach().numpy().view(np.complex64)[:, 0]


def _arguments(layout: GridLayout) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.int32]:
    # Plain arrays and numbers, since compiled code knows no dataclass.
    return layout.offsets, layout.resolutions, layout.dense, np.int32(2**layout.log2_entries - 1)


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
            with other encodings.
        layout: Resolutions of the levels and their places in the table.
        levels: Number of levels to evaluate, from the coarsest.

    Returns:
        The features, `(P, 2 * levels)`, stored feature by feature (column-major).
    """
    apply: Callable[..., Tensor] = _Encode.apply
    if isinstance(table, SharedTable):
        return apply(positions, table.table, layout, levels, table)
    return apply(positions, table, layout, levels, None)
