"""Fixtures that several rooms share."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

import pytest
import torch
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from torch import Tensor

from nerfreg.config import Config, own_folder, register, validated
from nerfreg.hooks import Rays, Rendering, Step


@pytest.fixture
def environment() -> dict[str, str]:
    """For a Python process that finds what this one finds, from any folder."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(os.path.abspath(path) for path in sys.path)}


@pytest.fixture
def compose() -> Callable[..., Config]:
    """Compose a configuration from overrides, as the command line does."""

    def compose(*overrides: str) -> Config:
        register()
        with initialize_config_dir(str(own_folder()), version_base="1.3"):
            return validated(hydra_compose("config", overrides=list(overrides)))

    return compose


@pytest.fixture
def step() -> Callable[..., Step]:
    """A step of a run of 100."""

    def step(index: int) -> Step:
        return Step(index, 100, index / 100, torch.Generator(), (1.0, 3.0), *[lambda rendering: rendering] * 2)

    return step


@pytest.fixture
def rays() -> Rays:
    """Two rays along z from the origin, sampled from 1 to 3."""
    direction = torch.tensor([[0.0, 0.0, 1.0]]).repeat(2, 1)
    return Rays(torch.zeros(2, 3), direction, torch.full((2,), 1.0), torch.full((2,), 3.0), torch.zeros(2, 3))


@pytest.fixture
def rendering() -> Callable[..., Rendering]:
    """A rendering of one sample per ray, of given opacity; everything else is zero."""

    def rendering(opacity: Tensor) -> Rendering:
        count = len(opacity)
        zeros, column, colors = torch.zeros(count), torch.zeros(count, 1), torch.zeros(count, 3)
        return Rendering(
            rays=Rays(colors, colors, zeros, zeros + 1, colors),
            t_edges=torch.tensor([[0.0, 1.0]]).repeat(count, 1),
            t=column + 0.5,
            density=column,
            tau=column,
            log_transmittance=column,
            weights=opacity[:, None],
            opacity=opacity,
            depth=zeros,
            rgb=colors,
            colored=column > 0,
        )

    return rendering
