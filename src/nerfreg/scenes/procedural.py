"""A scene that needs no files: textured solids on a ground, ray-traced exactly, with true depth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.scenes.base import SceneConfig, assemble
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.checks import check_choice
from nerfreg.scenes.layouts import FORWARD, LAYOUTS, OBJECT, ORBIT, ROOM
from nerfreg.scenes.poses import look_at
from nerfreg.scenes.procedural_solids import depth, depth_range, make_tracer, render
from nerfreg.scenes.scene import Scene
from nerfreg.scenes.splits import Split

FIELD_OF_VIEW = 0.69
"""Field of view along the narrower side of an image, in radians (about that of NeRF-Synthetic)."""

ORBIT_DISTANCE = 4.0
"""Distance of the cameras of an orbit from what they look at."""

FORWARD_DISTANCE = 3.0
"""Distance of forward-facing cameras from the plane through the middle of the solids."""

GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
"""Turning by it spreads any number of cameras evenly over the azimuths, without repetition."""

TARGET = np.array([0.0, 0.0, -0.05])
"""What all cameras look at: the middle of the solids, whose ground is at z = -0.5."""


@dataclass
class Procedural(SceneConfig):
    """Textured solids with view-dependent shading, around which cameras orbit or which they face.

    Training views do not depend on `test_views`, nor test views on `views`.

    Attributes:
        size: Width of the images in pixels.
        height: Height of the images in pixels; None for square images.
        test_views: Number of test views.
        seed: Seed of colours and textures.
    """

    views: int | None = 8
    layout: str | None = OBJECT
    size: int = 128
    height: int | None = None
    test_views: int = 8
    seed: int = 0

    def load(self) -> Scene:
        """Place cameras and solids. Images are rendered when they are first read, and kept."""
        layout = self._kind()
        around = layout != FORWARD
        cameras, split = self._cameras(layout)
        kept = self.after_holding_out(split)
        tracer = make_tracer(layout, self.seed)

        @cache
        def read_image(view: int) -> Tensor:
            return render(tracer, cameras, view, has_alpha=around)

        @cache
        def read_depth(view: int) -> Tensor:
            return depth(tracer, cameras, view)

        return assemble(
            replace(self, layout=layout),
            # Folders, presets and tables of earlier runs have this name.
            name=f"procedural-{ORBIT if around else FORWARD}",
            cameras=cameras,
            split=kept,
            labels=[
                f"{'train' if view in split.train else 'test'}/{view}"
                for view in range(len(cameras))
            ],
            read_image=read_image,
            has_alpha=around,
            depths=None if around else depth_range(tracer, cameras, kept.train),
            read_depth=read_depth,
        )

    def _kind(self) -> str:
        # None is allowed for all formats; cameras that are made here have nothing to tell a layout
        # by.
        layout = check_choice("scene.layout", self.layout or OBJECT, LAYOUTS)
        if layout == ROOM:
            raise NerfregError(
                f"scene.layout={ROOM}: procedural photographs from all around have alpha; "
                f"choose {OBJECT} or {FORWARD}"
            )
        return OBJECT if layout == ORBIT else layout

    def _cameras(self, layout: str) -> tuple[Cameras, Split]:
        views = 8 if self.views is None else self.views
        height = self.size if self.height is None else self.height
        for key, value in (
            ("views", views),
            ("test_views", self.test_views),
            ("size", self.size),
            ("height", height),
        ):
            if value < 1:
                raise NerfregError(f"scene.{key}={value}: must be at least 1")
        place = forward_positions if layout == FORWARD else orbit_positions
        positions = np.concatenate((place(views, False), place(self.test_views, True)))
        # Poses are made in double and rounded once, so that they are orthonormal to the last digit.
        up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
        poses = look_at(torch.from_numpy(positions), torch.from_numpy(TARGET), up)
        count = len(poses)
        # From the narrower side, so that the solids fit whatever the shape of the image.
        focal = 0.5 * min(self.size, height) / math.tan(0.5 * FIELD_OF_VIEW)
        cameras = Cameras(
            self.size,
            height,
            poses.float(),
            torch.full((count, 2), focal),
            torch.tensor([self.size / 2, height / 2]).expand(count, 2),
            torch.zeros(count, 5),
        )
        if self.split is None and self.train is None and self.test is None:
            return cameras, Split(tuple(range(views)), tuple(range(views, count)))
        # `views` has been used up for the number of cameras; the lists choose among these.
        return cameras, replace(self, views=None).split_of_one(count)


def orbit_positions(count: int, between: bool) -> Float[np.ndarray, "count 3"]:
    """Place cameras on the upper hemisphere, in a spiral from 15 to 65 degrees of elevation.

    Args:
        count: Number of cameras.
        between: Whether to turn and climb by half a step more, so that these cameras stand between
            the others.

    Returns:
        Their positions.
    """
    index = np.arange(count)
    azimuth = GOLDEN_ANGLE * (index + (0.5 if between else 0.0))
    share = (index + (1.0 if between else 0.5)) / (count + (1.0 if between else 0.0))
    # Even steps of the sine of the elevation are even steps of area on the sphere.
    low, high = math.sin(math.radians(15)), math.sin(math.radians(65))
    up = low + (high - low) * share
    across = np.sqrt(1 - up * up)
    return TARGET + ORBIT_DISTANCE * np.stack(
        (across * np.cos(azimuth), across * np.sin(azimuth), up), axis=1
    )


def forward_positions(count: int, between: bool) -> Float[np.ndarray, "count 3"]:
    """Place cameras side by side in a few rows, 1.4 wide and 0.7 high.

    Args:
        count: Number of cameras.
        between: Whether to use a smaller, shifted grid inside that one.

    Returns:
        Their positions.
    """
    # About twice as many columns as rows, like width and height of the grid.
    rows = max(1, round(math.sqrt(count / 2)))
    spots = []
    for row in range(rows):
        columns = count // rows + (row < count % rows)
        spots += [(_centered(column, columns), _centered(row, rows)) for column in range(columns)]
    grid = np.array(spots)
    if between:
        # The shift keeps every test camera off the training cameras, whatever the counts.
        grid = 0.7 * grid + (0.11, 0.17)
    x, z = grid.T
    return np.stack((0.7 * x, np.full(count, -FORWARD_DISTANCE), 0.35 * z + 0.4), axis=1)


def _centered(index: int, count: int) -> float:
    return 0.0 if count == 1 else 2 * index / (count - 1) - 1
