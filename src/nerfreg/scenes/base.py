"""The configuration and the last step of loading that all scene formats share."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.scenes import bounds, layouts, splits
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.checks import check_choice
from nerfreg.scenes.scene import Scene

BACKGROUNDS = {"white": 1.0, "black": 0.0}
"""Backgrounds by name, as the value of all three channels."""


@dataclass
class SceneConfig:
    """What every format understands.

    None stands for what the format, the cameras or the images imply.

    Attributes:
        path: Where the files are.
        views: Number of training views.
        split: "llff", "nerf_synthetic_8", "every_8" or "lists"; None for the usual protocol of the
            format.
        train: Numbers of the training views for the split "lists".
        test: Numbers of the test views for the split "lists".
        held_out: Positions among the training views (0 is the first) of those that are left out of
            training and scored in place of the test views, which are then not even read. For
            choices that must not depend on a test view.
        layout: The kind of capture, on which defaults depend: "forward" (cameras side by side),
            "object" (around an object, with known silhouettes) or "room" (opaque photographs around
            a place). "orbit" is an object or a room, by whether the images show silhouettes.
        background: "white" or "black", behind images with alpha.
        near: Where rays begin, in world units.
        far: Where rays end, in world units.
        box: Lower and upper corner of the modelled space, in world units.
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

    # No key: validation, which writes the kind that it has found into `layout`, sets this on the
    # instance.
    layout_found: ClassVar[bool] = False

    def load(self) -> Scene:
        """Read everything but the images.

        Returns:
            The scene.

        Raises:
            NerfregError: If a file or a value of the configuration is wrong.
        """
        raise NotImplementedError

    def split_of_one(self, count: int) -> splits.Split:
        """Split `count` images that are numbered together.

        Args:
            count: Number of images.

        Returns:
            The split that the configuration asks for.

        Raises:
            NerfregError: If the configuration asks for something impossible.
        """
        return splits.choose_from_one(self.split, count, self.views, self.train, self.test)

    def split_of_two(self, train_count: int, test_count: int) -> splits.Split:
        """Split frames that come in a training and a test file.

        Args:
            train_count: Number of frames in the training file.
            test_count: Number of frames in the test file.

        Returns:
            The split that the configuration asks for; the frames of each file are numbered from 0.

        Raises:
            NerfregError: If the configuration asks for something impossible.
        """
        return splits.choose_from_two(
            self.split, (train_count, test_count), self.views, self.train, self.test
        )

    def after_holding_out(self, split: splits.Split) -> splits.Split:
        """Apply `held_out` to a split, if it is set."""
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
    folder: Path | None = None,
    paths: Sequence[Path] = (),
) -> Scene:
    """Make a scene of what a format has read.

    Derives layout, box and bounds from the cameras, where the configuration does not give them.

    Args:
        config: The configuration.
        name: Name of the scene.
        cameras: Cameras of all views.
        split: Training and test views.
        labels: A name for each view, for messages and files.
        read_image: Reads the image of a view, in [0, 1].
        has_alpha: Whether the images have an alpha channel.
        layout: How the cameras of the format stand, "orbit" or "forward"; None to look at them.
        depths: Least and greatest depth seen from the training cameras; None if unknown.
        read_depth: Returns the true distance along the rays of a view; None if unknown.
        folder: The scene's folder; None for a scene that is not read from files.
        paths: The image file of each view; empty for a scene that is not read from files.

    Returns:
        The scene.

    Raises:
        NerfregError: If a value of the configuration is wrong, or if the position of the scene
            cannot be derived.
    """
    check_choice("scene.background", config.background, tuple(BACKGROUNDS))
    if config.layout is not None:
        check_choice("scene.layout", config.layout, layouts.LAYOUTS)
    layout = config.layout or layout or bounds.find_layout(cameras, split.train)
    if layout == layouts.ORBIT:
        layout = layouts.kind_of_orbit(has_alpha, split.train, read_image)
    box, near, far = _place(config, cameras, split, layout, depths)
    return Scene(
        name=name,
        layout=layout,
        layout_found=config.layout_found or layout != config.layout,
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
        folder=folder,
        paths=tuple(paths),
    )


def _place(
    config: SceneConfig,
    cameras: Cameras,
    split: splits.Split,
    layout: str,
    depths: tuple[float, float] | None,
) -> tuple[Float[Tensor, "2 3"], float, float]:
    """Box, near and far: the box covers what the training views see, the bounds reach all of it."""
    box = _given_box(config)
    for key, value in (("near", config.near), ("far", config.far)):
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise NerfregError(f"scene.{key}={value}: must be positive and finite")
    if layouts.stands_around(layout):
        if box is None:
            # By the kind and not by the alpha channel: who calls opaque photographs an object says
            # that there is nothing around it.
            extent = bounds.ROOM_EXTENT if layout == layouts.ROOM else 1.0
            box = bounds.orbit_box(cameras, split.train, extent)
        # Rays of the test cameras must reach the box, too, and these may stand nearer or farther.
        # The box itself depends on the training views alone.
        near, far = bounds.bounds_of_box(cameras, (*split.train, *split.test), box)
    elif box is not None and depths is None:
        # The given box is then better knowledge than a guess from the axes.
        near, far = bounds.bounds_of_box(cameras, split.train, box)
    else:
        # Nothing is derived where both are given: cameras that look at no common point would raise.
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
        # So far `far` has been a depth along the optical axis; rays measure distance, which is
        # longer towards the corners.
        far = bounds.ray_length(cameras, split.train, far)
    # What the user says holds to the letter, even where `far` was just lengthened.
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
