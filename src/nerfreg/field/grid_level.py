"""One level of a hash grid as a loss on the grid itself sees it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from nerfreg.errors import NerfregError
from nerfreg.field.grid_layout import FEATURES, GridLayout
from nerfreg.field.grid_lookup import SQUARED_DIFFERENCES, VERTEX_FEATURES, Lookup, read
from nerfreg.field.grid_shared import SharedTable, apply


class GridLevel:
    """One level of a hash grid, for losses on the grid itself.

    What is read here adds its gradient to the one buffer in which the encodings of the step collect
    theirs. So a loss may read as many levels as often as it likes, and pays for what it reads and
    not for the size of the table.

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
        compiled: Callable[[], bool],
    ) -> None:
        """Describe a level of a grid.

        Args:
            layout: Resolutions of the levels and their places in the table.
            level: Number of the level, from the coarsest.
            share: Returns the table of all levels as the operations of this step see it.
            compiled: Returns whether compiled kernels can read the table as it is now.
        """
        self.resolution = int(layout.resolutions[level])
        self.dense = bool(layout.dense[level])
        self._first, self._stop = (int(end) for end in layout.offsets[level : level + 2])
        self.entries = self._stop - self._first
        self._layout, self._level, self._share, self._compiled = layout, level, share, compiled

    @property
    def table(self) -> Float[Tensor, "entries 2"]:
        """The features of all entries, a view of the grid's parameter, `(E, 2)`.

        A dense level stores vertex (x, y, z) at `x + side * (y + side * z)`, where `side` is
        `resolution + 1`. Indexing the view works, but costs a gradient of the whole level; the
        methods cost less.
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
        values = self._read(VERTEX_FEATURES, vertices, self.resolution)
        return values.view(*vertices.shape[:-1], FEATURES)

    def squared_differences(self, vertices: Int[Tensor, "*any 3"]) -> Float[Tensor, "*any"]:
        """Compute how much the features change from vertices to the next ones along x, y and z.

        Total variation is the mean of these, or of their roots. The call costs a fraction of what
        looking up the four vertices and comparing them would.

        Args:
            vertices: Integer coordinates, 0 to `resolution - 1`, `(..., 3)`.

        Returns:
            The squared differences, summed over both features and the three axes, `(...)`,
            differentiable by the table.

        Raises:
            NerfregError: A vertex or the next one along an axis lies outside of the grid.
        """
        values = self._read(SQUARED_DIFFERENCES, vertices, self.resolution - 1)
        return values.view(vertices.shape[:-1])

    def _read(self, lookup: Lookup, vertices: Tensor, highest: int) -> Tensor:
        # The kernels would read and write wherever a vertex outside of the grid led them.
        if vertices.numel():
            low, high = (int(end) for end in torch.aminmax(vertices))
            if low < 0 or high > highest:
                raise NerfregError(
                    f"vertices must have coordinates 0 to {highest} here, not {low} to {high}: "
                    f"this level of the grid has {self.resolution} cells per side"
                )
        flat = vertices.reshape(-1, 3)
        if self._compiled():
            return read(lookup, self._share(), flat, self._layout, self._level)
        return lookup.plain(self.table, flat, self._layout, self._level)


class _Slice(torch.autograd.Function):
    """The entries of one level, whose gradient is added to the shared buffer."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, shared: SharedTable, first: int, stop: int) -> Tensor:
        ctx.shared, ctx.first, ctx.stop, ctx.entries = shared, first, stop, len(table)
        return table[first:stop]

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        if torch.is_grad_enabled():
            padding = (0, 0, ctx.first, ctx.entries - ctx.stop)
            return functional.pad(grads[0], padding), None, None, None
        buffer, new = ctx.shared.buffer()
        buffer[ctx.first : ctx.stop] += grads[0]
        return buffer if new else None, None, None, None
