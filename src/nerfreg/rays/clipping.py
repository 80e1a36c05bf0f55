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
    """Distances (R,) at which rays enter and leave the box, within [near, far]; equal for rays that miss it."""
    tiny = torch.finfo(directions.dtype).tiny
    safe = torch.where(directions.abs() < tiny, torch.full_like(directions, tiny), directions)
    crossings = (box[:, None] - origins) / safe
    enter = crossings.amin(dim=0).amax(dim=1).clamp(near, far)
    leave = crossings.amax(dim=0).amin(dim=1).clamp(near, far)
    return enter, torch.maximum(enter, leave)
