"""One level of a hash grid as a loss on the grid itself sees it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from nerfreg.errors import NerfregError
from nerfreg.field.grid_layout import FEATURES, GridLayout
from nerfreg.field.grid_shared import SharedTable, apply


@runtime_checkable
class Entries(Protocol):
    """Finds, reads and adds to entries of a level: `grid_lookup` (compiled) or `grid_torch`."""

    def entries(self, vertices: Tensor, layout: GridLayout, level: int) -> Tensor:
        """Find the entries of vertices within a level."""

    def gather(self, table: Tensor, rows: Tensor) -> Tensor:
        """Return the features of entries."""

    def add(self, table_grad: Tensor, rows: Tensor, grad: Tensor) -> None:
        """Add a gradient by the features to the gradient of the entries."""


class GridLevel:
    """One level of a hash grid, for losses on the grid itself.

    What is read here adds its gradient to the one buffer in which the encodings of the step
    collect theirs, so a loss may read as many levels as often as it likes and pays for the entries
    that it reads. Before the optimizer changes the table, the backward pass must have run; read
    again in the next step.

    Attributes:
        resolution: Cells per side; vertices have coordinates 0 to `resolution`.
        dense: Whether every vertex has an entry of its own. Otherwise the level is hashed, and
            vertices far apart may share one.
        entries: Number of entries, E.
    """

    def __init__(
        self,
        layout: GridLayout,
        level: int,
        share: Callable[[], SharedTable],
        how: Callable[[], Entries],
    ) -> None:
        """Describe a level of a grid.

        Args:
            layout: Resolutions of the levels and their places in the table.
            level: Number of the level, from the coarsest.
            share: Returns the table of all levels as operations of the current step see it.
            how: Returns what reads and writes the entries of the parameter as it is now.
        """
        self.resolution = int(layout.resolutions[level])
        self.dense = bool(layout.dense[level])
        self._first, self._stop = (int(end) for end in layout.offsets[level : level + 2])
        self.entries = self._stop - self._first
        self._layout, self._level, self._share, self._how = layout, level, share, how

    @property
    def table(self) -> Float[Tensor, "entries 2"]:
        """The features of all entries, a view of the grid's parameter, `(E, 2)`.

        A dense level stores vertex (x, y, z) at `x + side * (y + side * z)`, where `side` is
        `resolution + 1`.
        """
        shared = self._share()
        return apply(_Slice, shared.table, shared, self._first, self._stop)

    def features(self, vertices: Int[Tensor, "*any 3"]) -> Float[Tensor, "*any 2"]:
        """Look up the features of vertices.

        Args:
            vertices: Integer coordinates, 0 to `resolution`, `(..., 3)`.

        Returns:
            The features, `(..., 2)`, differentiable by the table.

        Raises:
            NerfregError: A vertex lies outside of the grid.
        """
        flat = vertices.reshape(-1, 3)
        self._require_inside(flat)
        shared, how, span = self._share(), self._how(), (self._first, self._stop)
        rows = how.entries(flat, self._layout, self._level)
        features = apply(_Lookup, shared.table, shared, rows, span, how)
        return features.view(*vertices.shape[:-1], FEATURES)

    def _require_inside(self, vertices: Tensor) -> None:
        # The kernels would read and write wherever such a vertex led them.
        if len(vertices):
            low, high = torch.aminmax(vertices)
            if low < 0 or high > self.resolution:
                raise NerfregError(
                    f"vertices of this level have coordinates 0 to {self.resolution}, "
                    f"not {int(low)} to {int(high)}"
                )


class _Slice(torch.autograd.Function):
    """The entries of one level, whose gradient is added to the shared buffer."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, shared: SharedTable, first: int, stop: int) -> Tensor:
        ctx.shared, ctx.span = shared, (first, stop)
        return table[first:stop]

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        first, stop = ctx.span
        if torch.is_grad_enabled():
            entries = ctx.shared.table.shape[0]
            return functional.pad(grads[0], (0, 0, first, entries - stop)), None, None, None
        buffer, new = ctx.shared.buffer()
        buffer[first:stop] += grads[0]
        return buffer if new else None, None, None, None


class _Lookup(torch.autograd.Function):
    """Single entries of one level, whose gradient is added to the shared buffer."""

    @staticmethod
    def forward(
        ctx: Any,
        table: Tensor,
        shared: SharedTable,
        rows: Tensor,
        span: tuple[int, int],
        how: Entries,
    ) -> Tensor:
        ctx.save_for_backward(rows)
        ctx.shared, ctx.span, ctx.how = shared, span, how
        return how.gather(table[span[0] : span[1]], rows)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        (rows,) = ctx.saved_tensors
        first, stop = ctx.span
        if torch.is_grad_enabled():
            zeros = torch.zeros_like(ctx.shared.table)
            table_grad = zeros.index_add(0, rows.long() + first, grads[0])
            return table_grad, None, None, None, None
        buffer, new = ctx.shared.buffer()
        ctx.how.add(buffer[first:stop], rows, grads[0])
        return buffer if new else None, None, None, None, None
