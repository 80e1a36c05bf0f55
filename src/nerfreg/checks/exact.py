"""How far numbers are from exact ones."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor


def relative_error(values: Any, truth: Any, dtype: str) -> float:
    """Return the largest error of values relative to exact ones.

    Where the exact value is below the smallest normal number of `dtype`, a value must be so too;
    the error counts as 0 then, else as infinite.

    Args:
        values: A tensor, a number or nested lists.
        truth: Exact values in the same structure.
        dtype: "float32" or "float64".

    Returns:
        The error, NaN if any value is.

    Raises:
        ValueError: There are more or fewer values than exact ones.
    """
    numbers, true = list(_flat(values)), list(_flat(truth))
    if len(numbers) != len(true):
        raise ValueError(f"{len(numbers)} values, but {len(true)} exact ones")
    # Rounding the truth to float64 costs 1e-16 of it.
    found, exact_values = torch.tensor([numbers, true], dtype=torch.float64)
    tiny = torch.finfo(getattr(torch, dtype)).tiny
    nothing = torch.where(found.abs() <= tiny, 0.0, torch.inf)
    normal = exact_values.abs() >= tiny
    errors = torch.where(normal, (found - exact_values).abs() / exact_values.abs(), nothing)
    errors = torch.where(found.isnan(), torch.nan, errors)
    return float(errors.max()) if len(errors) else 0.0


def _flat(values: Any) -> Iterator[float]:
    if isinstance(values, Tensor):
        yield from values.detach().double().flatten().tolist()
    elif isinstance(values, list | tuple):
        for value in values:
            yield from _flat(value)
    else:
        yield float(values)
