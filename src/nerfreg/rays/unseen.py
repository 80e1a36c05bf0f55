"""Cameras between the training cameras, where no photograph was taken."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from nerfreg.scenes.poses import pose


def poses_between(
    first: Float[Tensor, "cameras 3 4"],
    second: Float[Tensor, "cameras 3 4"],
    share: Float[Tensor, " cameras"],
    center: Float[Tensor, " 3"] | None = None,
) -> Float[Tensor, "cameras 3 4"]:
    """Interpolate between pairs of camera poses.

    Args:
        first: Poses at a share of 0.
        second: Poses at a share of 1.
        share: Where between the two, 0 to 1.
        center: The point that cameras on an orbit look at: positions move on a sphere around it
            (whose radius is interpolated), and the cameras face it. None for cameras side by side,
            whose positions and axes are interpolated linearly.

    Returns:
        The poses in between, `(C, 3, 4)`.
    """
    mix = share[:, None, None]
    blend = torch.lerp(first, second, mix)
    position, up, back = blend[..., 3], blend[..., 1], blend[..., 2]
    if center is not None:
        # A straight line between two cameras of an orbit would cut through the object. Only the
        # direction from the centre is interpolated, which never comes near 0 unless the cameras
        # stand opposite each other.
        a, b = first[..., 3] - center, second[..., 3] - center
        radius = torch.lerp(a.norm(dim=-1), b.norm(dim=-1), share)[:, None]
        position = center + radius * functional.normalize(
            torch.lerp(
                functional.normalize(a, dim=-1), functional.normalize(b, dim=-1), share[:, None]
            ),
            dim=-1,
        )
        back = position - center
    # The interpolated axes are neither of unit length nor orthogonal; `pose` makes a rotation.
    return pose(back, up, position)
