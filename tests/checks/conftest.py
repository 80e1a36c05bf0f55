"""Plugins from classes, without packages around them."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from nerfreg import Regularizer
from nerfreg.checks.subject import Subject
from nerfreg.registry import PluginInfo


@pytest.fixture(autouse=True)
def _python(python_random: None) -> None:
    """Every check may look at Python's generator."""


@pytest.fixture
def subject() -> Callable[[type[Regularizer]], Subject]:
    """A plugin under check, named "suspect"."""
    return lambda cls: Subject.of(PluginInfo("suspect", "tests", "0", cls))
