"""Small trainers, a plugin that fails when it is told to, and scenes of another size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.metadata import EntryPoint
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from nerfreg import Regularizer, Rendering, Step, hookimpl, registry
from nerfreg.config import Config
from nerfreg.registry import Hooks
from nerfreg.scenes import Scene, load_scene
from nerfreg.training.guard import Guard
from nerfreg.training.trainer import Trainer

SMALL = (
    "scene.size=24", "scene.views=3", "scene.test_views=1", "field.levels=4", "field.finest=64",
    "field.log2_entries=12", "sampler.coarse=16", "sampler.fine=16", "train.rays=128", "train.steps=40",
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


@pytest.fixture(autouse=True)
def faulty(monkeypatch: pytest.MonkeyPatch) -> type[Faulty]:
    """Installed under this name, like the plugin of any package."""
    installed = registry._entry_points()
    point = EntryPoint("faulty", f"{Faulty.__module__}:{Faulty.__name__}", registry.GROUP)
    monkeypatch.setattr(registry, "_entry_points", lambda: [*installed, point])
    monkeypatch.setattr(Faulty, "repaired", False)
    return Faulty


@pytest.fixture
def make(compose: Callable[..., Config]) -> Callable[..., Trainer]:
    """A trainer of a small configuration, its plugins under `hooks`, on a scene that `change` has changed."""

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


@pytest.fixture
def scaled() -> Callable[[Scene, float], Scene]:
    """The same scene with all distances multiplied by a factor; its images stay as they are."""

    def scaled(scene: Scene, factor: float) -> Scene:
        poses = scene.cameras.poses.clone()
        poses[:, :, 3] *= factor
        return replace(
            scene,
            cameras=replace(scene.cameras, poses=poses),
            box=scene.box * factor,
            near=scene.near * factor,
            far=scene.far * factor,
            read_depth=None,
        )

    return scaled
