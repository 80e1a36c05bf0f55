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
    """Poses a share of the way from the first to the second ones, (C, 3, 4).

    center: the point that cameras on an orbit look at; they keep their distance to it and look at it. None: cameras
    side by side, whose axes are interpolated.
    """
    mix = share[:, None, None]
    blend = torch.lerp(first, second, mix)
    position, up, back = blend[..., 3], blend[..., 1], blend[..., 2]
    if center is not None:
        a, b = first[..., 3] - center, second[..., 3] - center
        radius = torch.lerp(a.norm(dim=-1), b.norm(dim=-1), share)[:, None]
        position = center + radius * functional.normalize(
            torch.lerp(
                functional.normalize(a, dim=-1), functional.normalize(b, dim=-1), share[:, None]
            ),
            dim=-1,
        )
        back = position - center
    return pose(back, up, position)
