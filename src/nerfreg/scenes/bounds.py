"""Where a scene sits and how big it is, from nothing but its cameras and what is known of its depths."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.scenes.cameras import Cameras

OPAQUE_EXTENT = 4.0
"""Around an object that was cut out there is nothing. In a photograph there is a room: the box is this much larger
than what all cameras see, which puts the usual camera (half a field of view of 20 degrees, 3 radii away) inside it."""

NEAREST = 0.05
"""Rays begin at this fraction of the distance to what is looked at, where the box alone would let them begin at 0."""

DEPTH_MARGIN = 0.1
"""Known depths are those of some points, and usually without the most extreme ones, lest they be outliers. So the
nearest is taken this fraction nearer and the farthest this fraction farther."""

UNKNOWN_DEPTHS = (0.25, 4.0)
"""Forward-facing cameras without depths: from where to where, in distances to the point they look at."""

FORWARD_COHERENCE = 0.85
"""Cameras face forward if their mean viewing direction is at least this long: most within 30 degrees of it."""


def find_layout(cameras: Cameras, views: Sequence[int]) -> str:
    """`"forward"` if the cameras look in about the same direction, else `"orbit"`."""
    coherence = cameras.axes[list(views)].mean(0).norm()
    return "forward" if coherence > FORWARD_COHERENCE else "orbit"


def look_at_point(
    cameras: Cameras, views: Sequence[int], prior: Float[Tensor, " 3"] | None = None
) -> Float[Tensor, " 3"]:
    """The point nearest to the optical axes in the least-squares sense.

    It solves sum_i (I - a_i a_i^T) (p - o_i) = 0 for origins o and axes a. Along directions in which the axes leave it
    open (a single view, parallel axes), it is the solution nearest to `prior`, or else to the world's origin.
    """
    axes, origins = cameras.axes[list(views)].double(), cameras.positions[list(views)].double()
    across = torch.eye(3, dtype=torch.float64) - axes[:, :, None] * axes[:, None, :]
    start = torch.zeros(3).double() if prior is None else prior.double()
    residual = (across @ (origins - start)[:, :, None]).sum(0)[:, 0]
    point: Tensor = start + torch.linalg.pinv(across.sum(0), rtol=1e-5, hermitian=True) @ residual
    return point.float()


def orbit_box(cameras: Cameras, views: Sequence[int], has_alpha: bool) -> Float[Tensor, "2 3"]:
    """The cube around the largest ball that lies inside every view.

    Its centre is the point the cameras look at, its half side the smallest, over cameras, of the distance times the
    sine of the narrowest half field of view; for opaque photographs `OPAQUE_EXTENT` times that.
    """
    center = look_at_point(cameras, views)
    distances = _distances_ahead(cameras, views, center)
    size = torch.tensor([cameras.width, cameras.height])
    half_fields = torch.atan(0.5 * size / cameras.focal[list(views)]).amin(-1)
    radius = (distances * half_fields.sin()).min()
    half_side = radius * (1.0 if has_alpha else OPAQUE_EXTENT)
    return torch.stack((center - half_side, center + half_side))


def bounds_of_box(
    cameras: Cameras, views: Sequence[int], box: Float[Tensor, "2 3"]
) -> tuple[float, float]:
    """Nearest and farthest distance from the cameras to the ball around the box."""
    center, reach = box.mean(0), float((box[1] - box[0]).norm()) / 2
    distances = (cameras.positions[list(views)] - center).norm(dim=-1)
    nearest, farthest = float(distances.min()), float(distances.max())
    return max(NEAREST * nearest, nearest - reach), farthest + reach


def depth_bounds(nearest: float, farthest: float) -> tuple[float, float]:
    """Planes in front of and behind everything, given the least and the greatest known depth."""
    return nearest * (1 - DEPTH_MARGIN), farthest * (1 + DEPTH_MARGIN)


def guess_depth_bounds(cameras: Cameras, views: Sequence[int]) -> tuple[float, float]:
    """Planes for forward-facing cameras of which no depth is known, from where their axes meet."""
    distances = _distances_ahead(cameras, views, look_at_point(cameras, views))
    return UNKNOWN_DEPTHS[0] * float(distances.min()), UNKNOWN_DEPTHS[1] * float(distances.max())


def frustum(cameras: Cameras, view: int, depth: float) -> Float[Tensor, "4 3"]:
    """The corners of the image of a view, out in the world at a depth along its optical axis; in order around it."""
    width, height = float(cameras.width), float(cameras.height)
    corners = torch.tensor([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    origins, directions = cameras.rays_through(torch.full((4,), view), corners)
    along: Tensor = depth / (directions @ cameras.axes[view])
    return origins + directions * along[:, None]


def frusta_box(
    cameras: Cameras, views: Sequence[int], near: float, far: float
) -> Float[Tensor, "2 3"]:
    """The axis-aligned box of what the cameras see between two depths (measured along the optical axis)."""
    corners = torch.cat([frustum(cameras, view, depth) for view in views for depth in (near, far)])
    return torch.stack((corners.amin(0), corners.amax(0)))


def ray_length(cameras: Cameras, views: Sequence[int], depth: float) -> float:
    """The longest distance along a ray to a plane at `depth`: that through the corner farthest from the axis."""
    lengths = [
        (frustum(cameras, view, depth) - cameras.positions[view]).norm(dim=-1).max()
        for view in views
    ]
    return float(torch.stack(lengths).max())


def _distances_ahead(
    cameras: Cameras, views: Sequence[int], point: Float[Tensor, " 3"]
) -> Float[Tensor, " views"]:
    offsets = point - cameras.positions[list(views)]
    distances = offsets.norm(dim=-1)
    ahead = (offsets * cameras.axes[list(views)]).sum(-1)
    # Half the distance: a camera that looks 60 degrees past the point does not look at it.
    if not math.isfinite(float(distances.sum())) or bool((ahead <= 0.5 * distances).any()):
        raise NerfregError(
            "scene.box: the training cameras do not look at one place, so where the scene sits is unknown; "
            "give scene.box, scene.near and scene.far, or scene.layout=forward with scene.near and scene.far"
        )
    return distances
