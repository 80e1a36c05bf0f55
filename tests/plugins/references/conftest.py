"""Exact numbers for tests worked out by hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import mpmath
import pytest


@pytest.fixture(autouse=True)
def digits() -> Iterator[None]:
    with mpmath.workdps(50):
        yield


@pytest.fixture
def numbers() -> Callable[[Any], Any]:
    """Make mpmath numbers of (nested lists of) numbers, or of strings such as "1/3"."""

    def numbers(values: Any) -> Any:
        if isinstance(values, list):
            return [numbers(value) for value in values]
        return mpmath.mpf(values)

    return numbers


@pytest.fixture
def close() -> Callable[[Any, Any], bool]:
    """Tell whether two numbers agree in 45 digits."""
    return lambda a, b: mpmath.almosteq(a, b, rel_eps=mpmath.mpf(10) ** -45)
