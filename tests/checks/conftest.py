"""Plugins from classes, without packages around them."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from nerfreg import Regularizer
from nerfreg.checks.driver import Subject
from nerfreg.registry import PluginInfo


@pytest.fixture
def subject() -> Callable[[type[Regularizer]], Subject]:
    """A plugin under check, named "suspect"."""
    return lambda cls: Subject.of(PluginInfo("suspect", "tests", "0", cls))
