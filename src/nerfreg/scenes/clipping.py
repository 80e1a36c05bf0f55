"""The part of a ray that lies in the scene."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def clip_to_box(
    origins: Float[Tensor, "rays 3"],
    directions: Float[Tensor, "rays 3"],
    box: Float[Tensor, "2 3"],
    near: float,
    far: float,
) -> tuple[Float[Tensor, " rays"], Float[Tensor, " rays"]]:
    """Clip rays to an axis-aligned box, by intersecting its three slabs.

    Args:
        origins: Origins of the rays, `(R, 3)`.
        directions: Unit directions, `(R, 3)`.
        box: Lower and upper corner.
        near: Least distance to return.
        far: Greatest distance to return.

    Returns:
        The distances at which the rays enter and leave the box within [near, far], `(R,)` each.
        They are equal for rays that miss it.
    """
    # A ray parallel to a slab never crosses its planes, and 0 / 0 would be NaN for an origin on one
    # of them. With the smallest normal number for 0 the planes are practically infinitely far away,
    # in opposite directions if the origin is inside the slab and in the same direction if it is
    # not, so that the ray misses the box then.
    tiny = torch.finfo(directions.dtype).tiny
    safe = torch.where(directions.abs() < tiny, torch.full_like(directions, tiny), directions)
    crossings = (box[:, None] - origins) / safe
    enter = crossings.amin(dim=0).amax(dim=1).clamp(near, far)
    leave = crossings.amax(dim=0).amin(dim=1).clamp(near, far)
    # Rays that miss the box leave one slab before they enter another.
    return enter, torch.maximum(enter, leave)
