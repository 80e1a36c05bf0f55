"""A scene: its cameras, images that are read on demand, its bounds and its split."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.scenes.cameras import Cameras


@dataclass(frozen=True)
class Photographs:
    """What training may look at, and nothing of the test views.

    Attributes:
        cameras: The cameras of the V training views, numbered from 0.
        images: The photographs in [0, 1], `(V, H, W, C)`; C is 3, or 4 with straight alpha.
        near: Where rays begin, in world units.
        far: Where rays end, in world units.
        layout: How the cameras are placed, "orbit" (around an object) or "forward" (side by side).
    """

    cameras: Cameras
    images: Float[Tensor, "views height width channels"]
    near: float
    far: float
    layout: str


@dataclass(frozen=True)
class Scene:
    """Everything the core knows about a scene.

    Attributes:
        name: Name of the scene.
        layout: How the cameras are placed, "orbit" (around an object) or "forward" (side by side).
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
