"""Plugins from classes, without packages around them."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from nerfreg import Regularizer
from nerfreg.checks.subject import Subject
from nerfreg.registry import PluginInfo


@pytest.fixture(autouse=True)
def _python(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tests' type checker draws from Python's generator; another one takes its place."""
    monkeypatch.setattr("nerfreg.checks.watch.random", random.Random(0))


@pytest.fixture
def subject() -> Callable[[type[Regularizer]], Subject]:
    """A plugin under check, named "suspect"."""
    return lambda cls: Subject.of(PluginInfo("suspect", "tests", "0", cls))
