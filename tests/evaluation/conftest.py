from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.scene import Scene

DATA = os.environ.get("NERFREG_DATA")
"""Read once: some tests unset the variable for themselves."""


@pytest.fixture
def data() -> Path:
    """The folder of real photographs and weights."""
    if not DATA:
        pytest.skip("NERFREG_DATA is not set: no real data to test with")
    return Path(DATA)


def make_cameras(poses: Tensor, width: int = 12, height: int = 8) -> Cameras:
    count = len(poses)
    return Cameras(
        width=width,
        height=height,
        poses=poses,
        focal=torch.tensor([10.0, 11.0]).repeat(count, 1),
        center=torch.tensor([width / 2, height / 2]).repeat(count, 1),
        distortion=torch.zeros(count, 5),
    )


def make_scene(
    poses: Tensor | None = None,
    images: list[Tensor] | None = None,
    depths: list[Tensor] | None = None,
    background: Tensor | None = None,
    layout: str = "object",
    near: float = 1.0,
    far: float = 3.0,
) -> Scene:
    """A scene made of what is given; all views are training and test views at once."""
    if poses is None:
        assert images is not None
        poses = torch.eye(3, 4).repeat(len(images), 1, 1)
    views = tuple(range(len(poses)))
    read_image: Callable[[int], Tensor] = (images or []).__getitem__
    return Scene(
        name="made up",
        layout=layout,
        cameras=make_cameras(poses),
        train=views,
        test=views,
        box=torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]),
        near=near,
        far=far,
        read_image=read_image,
        has_alpha=background is not None,
        background=background,
        read_depth=None if depths is None else depths.__getitem__,
    )


@pytest.fixture(name="make_scene")
def make_scene_fixture() -> Callable[..., Scene]:
    return make_scene
