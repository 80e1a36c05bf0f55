"""A plugin that fails when it is told to, installed for every test, and scenes of another size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from nerfreg.scenes import Scene


@pytest.fixture(autouse=True)
def _faulty(faulty: type) -> None:
    """Every test of training may select it."""


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
