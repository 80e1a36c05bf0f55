"""Camera poses: 3 x 4 camera-to-world matrices with x right, y up, looking along -z (OpenGL)."""

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
    """Make poses of cameras that have a target in the middle of their image.

    Args:
        position: Where the cameras are.
        target: What they look at.
        up: The direction that is up in their images, as far as the view allows.

    Returns:
        Camera-to-world matrices.
    """
    return pose(position - target, up, position)


def pose(
    back: Float[Tensor, "*cameras 3"],
    up: Float[Tensor, "*#cameras 3"],
    position: Float[Tensor, "*cameras 3"],
) -> Float[Tensor, "*cameras 3 4"]:
    """Make poses from a viewing direction.

    Args:
        back: The direction opposite to the view, of any length.
        up: The direction that is up in the images, as far as the view allows; not parallel to
            `back`.
        position: Where the cameras are.

    Returns:
        Camera-to-world matrices.
    """
    z = functional.normalize(back, dim=-1)
    x = functional.normalize(torch.linalg.cross(up.expand_as(z), z), dim=-1)
    # z x x has unit length already, since z and x are orthonormal.
    return torch.stack([x, torch.linalg.cross(z, x), z, position], dim=-1)


def recenter(poses: Float[Tensor, "views 3 4"]) -> Float[Tensor, "views 3 4"]:
    """Move the world rigidly so that the average camera is at the origin and looks along -z.

    Args:
        poses: Camera-to-world matrices.

    Returns:
        The poses in the moved world, whose unit is the same.
    """
    average = pose(poses[:, :, 2].sum(0), poses[:, :, 1].sum(0), poses[:, :, 3].mean(0))
    rotation = average[:, :3].T
    moved = rotation @ poses
    moved[:, :, 3] -= rotation @ average[:, 3]
    return moved
