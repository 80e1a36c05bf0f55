"""A scene: cameras, images read when asked for, where to look, and which views are for what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.scenes.cameras import Cameras


@dataclass(frozen=True)
class Photographs:
    """What training may look at, and nothing of the test views: V views, numbered from 0.

    images: (V, H, W, C) in [0, 1], C = 3, or 4 with straight alpha. near, far: bounds of every ray, world units.
    layout: how the cameras stand, "orbit" (around an object) or "forward" (side by side).
    """

    cameras: Cameras
    images: Float[Tensor, "views height width channels"]
    near: float
    far: float
    layout: str


@dataclass(frozen=True)
class Scene:
    """Everything the core knows about a scene. View numbers index `cameras`.

    layout: how the cameras stand, "orbit" (around an object) or "forward" (side by side).
    train, test: view numbers of the split. box: (2, 3) lower and upper corner of the space that is modelled.
    near, far: bounds of every ray, world units; rays are clipped to the box besides.
    read_image: view -> (H, W, C) in [0, 1], C = 3, or 4 with straight alpha; has_alpha says which.
    read_depth: view -> (H, W) distance along the ray, inf where there is nothing; None if depth is unknown.
    background: colour (3,) that images with alpha are composited on when they are scored; None without alpha.
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

    def photographs(self) -> Photographs:
        """Read the training views."""
        images = torch.stack([self.read_image(view) for view in self.train])
        return Photographs(self.cameras.of(self.train), images, self.near, self.far, self.layout)
