"""Fixtures for pytest: put `pytest_plugins = ["nerfreg.testing.fixtures"]` into `conftest.py`."""

from __future__ import annotations

import pytest
import torch

from nerfreg.hooks import Rendering, Step
from nerfreg.scenes import Scene
from nerfreg.testing import cases, training


@pytest.fixture
def rendering() -> Rendering:
    """Smooth fog in float64, whose density is a leaf that requires a gradient."""
    return cases.make_rendering(dtype=torch.float64)


@pytest.fixture
def step() -> Step:
    """The step in the middle of a run, in which `rendering` is rendered."""
    return cases.make_step(dtype=torch.float64)


@pytest.fixture(params=cases.CASE_NAMES)
def extreme_rendering(request: pytest.FixtureRequest) -> Rendering:
    """Each case of `nerfreg check` in float32: the test runs once for each."""
    return cases.make_rendering(request.param)


@pytest.fixture(scope="session")
def small_scene() -> Scene:
    """Solids in three training views and a test view of 24 x 24 pixels."""
    return training.small_scene()
