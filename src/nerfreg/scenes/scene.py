"""A scene: its cameras, images that are read on demand, its bounds and its split."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.clipping import clip_to_box
from nerfreg.scenes.layouts import stands_around

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class SceneInfo:
    """What may be known of a scene before there are rays, and nothing of the test views.

    Attributes:
        cameras: The cameras of the V training views, numbered from 0.
        box: Lower and upper corner of the modelled space, `(2, 3)`, in world units.
        near: Where rays begin, in world units.
        far: Where rays end, in world units.
        layout: The kind of capture: "forward", "object" or "room" (`nerfreg.scenes.layouts`).
        name: Name of the scene.
        folder: The scene's folder; None for a scene that is not read from files.
        labels: A name for each training view; empty if they have none.
        paths: The file of each training image; empty for a scene that is not read from files.
        metres_per_unit: Length of a world unit in metres; None where it is not known.
    """

    cameras: Cameras
    box: Float[Tensor, "2 3"]
    near: float
    far: float
    layout: str
    name: str = ""
    folder: Path | None = None
    labels: tuple[str, ...] = ()
    paths: tuple[Path, ...] = ()
    metres_per_unit: float | None = None

    @property
    def center(self) -> Float[Tensor, " 3"]:
        """Centre of the box, `(3,)`."""
        return self.box.mean(dim=0)

    @property
    def around(self) -> bool:
        """Whether the cameras stand around what they show, and not side by side."""
        return stands_around(self.layout)

    @property
    def half_box(self) -> float:
        """Half the longest side of the box, in world units."""
        return float((self.box[1] - self.box[0]).max()) / 2

    def unit(self, positions: Float[Tensor, "*points 3"]) -> Float[Tensor, "*points 3"]:
        """Map world positions to the unit cube that encoders see: the cube around the box."""
        return (positions - self.center.to(positions)) / (2 * self.half_box) + 0.5

    def clipped(
        self, origins: Float[Tensor, "rays 3"], directions: Float[Tensor, "rays 3"]
    ) -> tuple[Float[Tensor, " rays"], Float[Tensor, " rays"]]:
        """Return the distances at which rays enter and leave the box, `(R,)` each."""
        return clip_to_box(origins, directions, self.box.to(origins), self.near, self.far)


@dataclass(frozen=True, kw_only=True)
class Photographs(SceneInfo):
    """The training views themselves, with whatever else the scene's files say of their pixels.

    Images of different sizes are padded at the right and at the bottom to one array; per-pixel data
    that plugins make of them have the same shape.

    Attributes:
        images: The photographs in [0, 1], `(V, H, W, C)`; C is 3, or 4 with straight alpha.
        valid: Which pixels belong to a photograph, `(V, H, W)`; None: all of them.
        masks: Which pixels show what is to be modelled, `(V, H, W)`; None where there are no masks.
        depth: Distance along the rays, `(V, H, W)`, in world units, NaN where it is not known; None
            where the files have no depth.
        points: Sparse points of the scene, `(P, 3)`, in world units; None where there are none.
        point_views: Pairs of numbers, of a training view and of a point that it shows, `(O, 2)`;
            None where that is not known.
        known_depth: Interval of distance along the rays in which plugins know a surface,
            `(V, H, W, 2)`, in world units, NaN where they do not; None if none of them knows
            anything, and as long as they have not been asked.
    """

    images: Float[Tensor, "views height width channels"]
    valid: Bool[Tensor, "views height width"] | None = None
    masks: Bool[Tensor, "views height width"] | None = None
    depth: Float[Tensor, "views height width"] | None = None
    points: Float[Tensor, "points 3"] | None = None
    point_views: Int[Tensor, "observations 2"] | None = None
    known_depth: Float[Tensor, "views height width 2"] | None = None


@dataclass(frozen=True)
class Scene:
    """Everything the core knows about a scene.

    Attributes:
        name: Name of the scene.
        layout: The kind of capture: "forward", "object" or "room" (`nerfreg.scenes.layouts`).
        cameras: The cameras of all views; view numbers index them.
        train: Numbers of the training views.
        test: Numbers of the test views.
        box: Lower and upper corner of the modelled space, `(2, 3)`, in world units.
        near: Where rays begin, in world units; they are also clipped to the box.
        far: Where rays end, in world units; they are also clipped to the box.
        read_image: Returns the image of a view in [0, 1], `(H, W, C)`; C is 3, or 4 with straight
            alpha.
        has_alpha: Whether images have an alpha channel.
        background: The colour `(3,)` on which images with alpha are composited when they are
            scored; None without alpha.
        read_depth: Returns the distance along the rays of a view, `(H, W)`, inf where there is
            nothing; None if depth is unknown.
        labels: A name for each view, for messages and files.
        folder: The scene's folder; None for a scene that is not read from files.
        paths: The image file of each view; empty for a scene that is not read from files.
        layout_found: Whether `layout` was found in cameras and images, and not named by the user.
    """

    name: str
    layout: str
    cameras: Cameras
    train: tuple[int, ...]
    test: tuple[int, ...]
    box: Float[Tensor, "2 3"]
    near: float
    far: float
    read_image: Callable[[int], Float[Tensor, "height width channels"]]
    has_alpha: bool
    background: Float[Tensor, " 3"] | None
    read_depth: Callable[[int], Float[Tensor, "height width"]] | None = None
    labels: tuple[str, ...] = ()
    folder: Path | None = None
    paths: tuple[Path, ...] = ()
    layout_found: bool = False

    @property
    def around(self) -> bool:
        """Whether the cameras stand around what they show, and not side by side."""
        return stands_around(self.layout)

    @cached_property
    def info(self) -> SceneInfo:
        """What plugins may know of the scene."""
        return SceneInfo(**self._info())

    def photographs(self) -> Photographs:
        """Read the training views."""
        images = torch.stack([self.read_image(view) for view in self.train])
        return Photographs(images=images, **self._info())

    def _info(self) -> dict[str, Any]:
        def of_training(of_all: tuple[T, ...]) -> tuple[T, ...]:
            return tuple(of_all[view] for view in self.train) if of_all else ()

        return {
            "cameras": self.cameras.of(self.train),
            "box": self.box,
            "near": self.near,
            "far": self.far,
            "layout": self.layout,
            "name": self.name,
            "folder": self.folder,
            "labels": of_training(self.labels),
            "paths": of_training(self.paths),
        }
