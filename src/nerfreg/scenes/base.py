"""The configuration that all formats share, and the last step of loading, which is the same for all."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.scenes import bounds, splits
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.checks import check_choice
from nerfreg.scenes.scene import Scene

LAYOUTS = ("orbit", "forward")
BACKGROUNDS = {"white": 1.0, "black": 0.0}


@dataclass
class SceneConfig:
    """What every format understands. None stands for what the format, the cameras or the images say.

    path: where the files lie. views: number of training views.
    split: "llff", "nerf_synthetic_8", "every_8" or "lists"; None: what is usual for the format.
    train, test: view numbers for the split "lists".
    held_out: which of the training views (0: the first) are left out of training and scored in place of the test
        views, which are then not even read. For choices that must not look at a test view.
    layout: how the cameras stand, "orbit" (around an object) or "forward" (side by side).
    background: "white" or "black", behind images with alpha.
    near, far: bounds of every ray. box: lower and upper corner of the space that is modelled. World units.
    """

    path: str | None = None
    views: int | None = None
    split: str | None = None
    train: list[int] | None = None
    test: list[int] | None = None
    held_out: list[int] | None = None
    layout: str | None = None
    background: str = "white"
    near: float | None = None
    far: float | None = None
    # Not list[list[float]]: OmegaConf does not turn the integers of a nested list into floats.
    box: list[Any] | None = None

    def load(self) -> Scene:
        """Read what the scene needs before any image is read. Raises NerfregError for bad input."""
        raise NotImplementedError

    def split_of_one(self, count: int) -> splits.Split:
        """The split of `count` images that lie together."""
        return splits.choose_from_one(self.split, count, self.views, self.train, self.test)

    def split_of_two(self, train_count: int, test_count: int) -> splits.Split:
        """The split of frames that come in a training and a test file, each numbered from 0."""
        return splits.choose_from_two(
            self.split, (train_count, test_count), self.views, self.train, self.test
        )

    def after_holding_out(self, split: splits.Split) -> splits.Split:
        """The split, or what `held_out` makes of it."""
        return split if self.held_out is None else splits.hold_out(split, self.held_out)


def assemble(
    config: SceneConfig,
    name: str,
    cameras: Cameras,
    split: splits.Split,
    labels: Sequence[str],
    read_image: Callable[[int], Float[Tensor, "height width channels"]],
    has_alpha: bool,
    layout: str | None = None,
    depths: tuple[float, float] | None = None,
    read_depth: Callable[[int], Float[Tensor, "height width"]] | None = None,
) -> Scene:
    """Make a scene of what a format read: find where it sits, and let the configuration override that.

    layout: the usual one for the format; None: whatever the cameras say.
    depths: least and greatest depth seen from the training cameras; None where no depth is known.
    """
    check_choice("scene.background", config.background, tuple(BACKGROUNDS))
    if config.layout is not None:
        check_choice("scene.layout", config.layout, LAYOUTS)
    layout = config.layout or layout or bounds.find_layout(cameras, split.train)
    box, near, far = _place(config, cameras, split, layout, has_alpha, depths)
    return Scene(
        name=name,
        layout=layout,
        cameras=cameras,
        train=split.train,
        test=split.test,
        box=box,
        near=near,
        far=far,
        read_image=read_image,
        has_alpha=has_alpha,
        background=torch.full((3,), BACKGROUNDS[config.background]) if has_alpha else None,
        read_depth=read_depth,
        labels=tuple(labels),
    )


def _place(
    config: SceneConfig,
    cameras: Cameras,
    split: splits.Split,
    layout: str,
    has_alpha: bool,
    depths: tuple[float, float] | None,
) -> tuple[Float[Tensor, "2 3"], float, float]:
    """Box, near and far. The box covers what the training views see; the bounds reach it from every camera."""
    box = _given_box(config)
    for key, value in (("near", config.near), ("far", config.far)):
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise NerfregError(f"scene.{key}={value}: must be positive and finite")
    if layout == "orbit":
        if box is None:
            box = bounds.orbit_box(cameras, split.train, has_alpha)
        near, far = bounds.bounds_of_box(cameras, (*split.train, *split.test), box)
    elif box is not None and depths is None:
        near, far = bounds.bounds_of_box(cameras, split.train, box)
    else:
        if config.near and config.far:
            near, far = config.near, config.far
        else:
            near, far = (
                bounds.depth_bounds(*depths)
                if depths
                else bounds.guess_depth_bounds(cameras, split.train)
            )
            near, far = config.near or near, config.far or far
        if box is None:
            box = bounds.frusta_box(cameras, split.train, near, far)
        far = bounds.ray_length(cameras, split.train, far)
    near, far = config.near or near, config.far or far
    if not near < far:
        raise NerfregError(f"scene.near={near:g}: must be less than scene.far={far:g}")
    return box, near, far


def _given_box(config: SceneConfig) -> Float[Tensor, "2 3"] | None:
    if config.box is None:
        return None
    try:
        box = torch.tensor(config.box, dtype=torch.float32)
    except (TypeError, ValueError):
        box = torch.empty(0)
    if box.shape != (2, 3):
        raise NerfregError(
            f"scene.box={config.box}: must be two corners, e.g. [[-1,-1,-1],[1,1,1]]"
        )
    if not (torch.isfinite(box).all() and (box[0] < box[1]).all()):
        raise NerfregError(
            f"scene.box={config.box}: the first corner must be below the second in x, y and z"
        )
    return box
