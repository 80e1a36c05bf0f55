"""Fixtures that the tests of several packages share."""

from __future__ import annotations

import json
import os
import random
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import ClassVar

import imageio.v3 as iio
import pytest
import torch
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from torch import Tensor

from nerfreg import Regularizer, hookimpl
from nerfreg.config.folders import own_folder
from nerfreg.config.schema import Config, register
from nerfreg.config.validation import validated
from nerfreg.hooks import Rays, Rendering, Step
from nerfreg.registry import Hooks, plugins
from nerfreg.scenes import Procedural, Scene, load_scene
from nerfreg.training.guard import Guard
from nerfreg.training.trainer import Trainer

SMALL = (
    "scene.size=24", "scene.views=3", "scene.test_views=1", "field.levels=4", "field.finest=64",
    "field.log2_entries=12", "sampler.coarse=16", "sampler.fine=16", "train.rays=128",
    "train.steps=40",
)  # fmt: skip


@dataclass
class Faulty(Regularizer):
    """A smooth term that goes wrong at `steps`, in one of three ways."""

    steps: list[int] = field(default_factory=list)
    way: str = "value"

    repaired: ClassVar[bool] = False

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Tensor]:
        fine = rendering.opacity.square().mean()
        if step.index not in self.steps or self.repaired:
            return {"faulty": fine}
        if self.way == "value":
            return {"faulty": fine * torch.nan}
        if self.way == "gradient":  # the root of exactly 0 is 0, and its slope infinite
            return {"faulty": fine + (rendering.opacity[7] - rendering.opacity[7].detach()).sqrt()}
        return {"faulty": fine * 1e30}  # finite, gradient and all, but for its square


@pytest.fixture
def environment() -> dict[str, str]:
    """For a Python process that finds what this one finds, from any folder."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(os.path.abspath(path) for path in sys.path)}


@pytest.fixture
def python_random(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tests' type checker draws from Python's generator; `check` watches another one."""
    monkeypatch.setattr("nerfreg.checks.watch.random", random.Random(0))


@pytest.fixture
def compose() -> Callable[..., Config]:
    """Compose a configuration from overrides, as the command line does."""

    def compose(*overrides: str) -> Config:
        register()
        with initialize_config_dir(str(own_folder()), version_base="1.3"):
            return validated(hydra_compose("config", overrides=list(overrides)))

    return compose


@pytest.fixture
def capture(tmp_path: Path) -> Callable[..., Path]:
    """Write photographs from all around as a transforms.json; RGBA that is opaque if alpha is 1."""

    def capture(channels: int, alpha: float | None = None) -> Path:
        scene = Procedural(size=16, views=4, test_views=2).load()
        folder = tmp_path / "thing"
        folder.mkdir()
        frames = []
        for view in (*scene.train, *scene.test):
            image = scene.read_image(view)[..., :channels].clone()
            if alpha is not None:
                image[..., 3] = alpha
            iio.imwrite(folder / f"{view}.png", (255 * image).round().to(torch.uint8).numpy())
            pose = [*scene.cameras.poses[view].tolist(), [0.0, 0.0, 0.0, 1.0]]
            frames.append({"file_path": f"{view}.png", "transform_matrix": pose})
        content = {"fl_x": float(scene.cameras.focal[0, 0]), "frames": frames}
        (folder / "transforms.json").write_text(json.dumps(content), encoding="utf-8")
        return folder

    return capture


@pytest.fixture
def step() -> Callable[..., Step]:
    """A step of a run of 100."""

    def step(index: int) -> Step:
        return Step(
            index,
            100,
            index / 100,
            torch.Generator(),
            (1.0, 3.0),
        )

    return step


@pytest.fixture
def rays() -> Rays:
    """Two rays along z from the origin, sampled from 1 to 3."""
    direction = torch.tensor([[0.0, 0.0, 1.0]]).repeat(2, 1)
    return Rays(
        torch.zeros(2, 3),
        direction,
        torch.full((2,), 1.0),
        torch.full((2,), 3.0),
        torch.zeros(2, 3),
    )


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


@pytest.fixture
def faulty(monkeypatch: pytest.MonkeyPatch) -> type[Faulty]:
    """Installed under this name, like the plugin of any package."""
    installed = plugins._entry_points()
    point = EntryPoint("faulty", f"{Faulty.__module__}:{Faulty.__name__}", plugins.GROUP)
    monkeypatch.setattr(plugins, "_entry_points", lambda: [*installed, point])
    monkeypatch.setattr(Faulty, "repaired", False)
    return Faulty


@pytest.fixture
def make(compose: Callable[..., Config]) -> Callable[..., Trainer]:
    """Make a trainer of a small configuration, on a scene that `change` has changed."""

    def make(
        *overrides: str,
        hooks: Callable[..., Hooks] = Hooks,
        change: Callable[[Scene], Scene] = lambda scene: scene,
        guard: Guard | None = None,
    ) -> Trainer:
        config = compose(*SMALL, *overrides)
        scene = change(load_scene(config.scene))
        return Trainer(
            scene,
            hooks(config.reg),
            config.field,
            config.sampler,
            config.optim,
            config.train,
            config.seed,
            guard=guard,
        )

    return make
