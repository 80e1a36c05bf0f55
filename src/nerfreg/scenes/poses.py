"""Camera poses: 3 x 4 camera-to-world matrices with OpenGL axes (x right, y up, looking along -z)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional


def look_at(
    position: Float[Tensor, "*cameras 3"],
    target: Float[Tensor, "*#cameras 3"],
    up: Float[Tensor, "*#cameras 3"],
) -> Float[Tensor, "*cameras 3 4"]:
    """Poses of upright cameras at `position` that see `target` in the middle, with `up` upward."""
    return pose(position - target, up, position)


def pose(
    back: Float[Tensor, "*cameras 3"],
    up: Float[Tensor, "*#cameras 3"],
    position: Float[Tensor, "*cameras 3"],
) -> Float[Tensor, "*cameras 3 4"]:
    """Poses of cameras that look along -`back`, with y as near to `up` as that allows."""
    z = functional.normalize(back, dim=-1)
    x = functional.normalize(torch.linalg.cross(up.expand_as(z), z), dim=-1)
    return torch.stack([x, torch.linalg.cross(z, x), z, position], dim=-1)


def recenter(poses: Float[Tensor, "views 3 4"]) -> Float[Tensor, "views 3 4"]:
    """Move the world rigidly so that the average camera stands at the origin and looks along -z. Keeps its unit."""
    average = pose(poses[:, :, 2].sum(0), poses[:, :, 1].sum(0), poses[:, :, 3].mean(0))
    rotation = average[:, :3].T
    moved = rotation @ poses
    moved[:, :, 3] -= rotation @ average[:, 3]
    return moved
