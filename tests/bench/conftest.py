"""Small configurations for the benches that train."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import pytest

from nerfreg.bench import configured, timing
from nerfreg.training.trainer import Trainer

SCENE = ("scene.size=24", "scene.views=3", "scene.test_views=2", "train.threads=1")


@pytest.fixture
def make() -> Callable[..., Trainer]:
    """A tiny trainer of a configuration."""

    def make(*overrides: str) -> Trainer:
        config, scene = configured.set_up((*configured.TINY, *SCENE, *overrides))
        return configured.make_trainer(config, scene)

    return make


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A clock that stands still unless somebody adds to `now`."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(timing, "perf_counter", lambda: clock.now)
    return clock
