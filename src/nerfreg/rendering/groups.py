"""Rays of one group share their distances: one row for each group, and back to one for each ray."""

from __future__ import annotations

from torch import Tensor


def per_group(values: Tensor, groups: Tensor | None, reduce: str) -> Tensor:
    """Return the smallest, largest or mean of the rows of each group; all rows without groups."""
    if groups is None:
        return values
    count = int(groups.max()) + 1
    index = groups if values.dim() == 1 else groups[:, None].expand_as(values)
    shape = (count, *values.shape[1:])
    # The zeros must not take part, or the smallest of positive values would be 0.
    return values.new_zeros(shape).scatter_reduce(0, index, values, reduce, include_self=False)


def per_ray(values: Tensor, groups: Tensor | None) -> Tensor:
    """Return the row of each ray's group."""
    return values if groups is None else values[groups]
