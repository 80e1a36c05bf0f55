"""Derive where a scene is and how large it is from its cameras and its known depths."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.scenes.cameras import Cameras

ROOM_EXTENT = 4.0
"""How much larger the box of a room is than that of an object, the cube that all cameras see.
Around an object with alpha there is nothing, but in a photograph there are its surroundings. Four
times puts the usual camera (20 degrees of half field of view, so about 3 radii away) inside."""

NEAREST = 0.05
"""Rays begin no nearer than at this fraction of the distance from the nearest camera to the centre
of the box. Those of a camera inside the box would otherwise begin at 0."""

DEPTH_MARGIN = 0.1
"""Fraction by which the nearest known depth is taken nearer and the farthest one farther. Known
depths are those of sparse points, usually percentiles, which stop short of the true extremes."""

UNKNOWN_DEPTHS = (0.25, 4.0)
"""Near and far for forward-facing cameras without depths, in distances to where their axes meet."""

FORWARD_COHERENCE = 0.85
"""Least length of the mean viewing direction of forward-facing cameras. The cosine of 30 degrees is
0.87: most cameras look within 30 degrees of the mean."""


def find_layout(cameras: Cameras, views: Sequence[int]) -> str:
    """Tell forward-facing cameras from an orbit.

    Args:
        cameras: The cameras.
        views: The views to look at.

    Returns:
        "forward" if the cameras look in about the same direction, else "orbit".
    """
    coherence = cameras.axes[list(views)].mean(0).norm()
    return "forward" if coherence > FORWARD_COHERENCE else "orbit"


def look_at_point(
    cameras: Cameras, views: Sequence[int], prior: Float[Tensor, " 3"] | None = None
) -> Float[Tensor, " 3"]:
    """Find the point nearest to the optical axes in the least-squares sense.

    It solves sum_i (I - a_i a_i^T) (p - o_i) = 0 for origins o and unit axes a.

    Args:
        cameras: The cameras.
        views: The views to look at.
        prior: Where axes do not determine the point (a single view, parallel axes), the solution
            nearest to this point is taken; None for the origin of the world.

    Returns:
        The point, `(3,)`.
    """
    # In double: the matrix is a difference of nearly equal numbers where axes are nearly parallel.
    axes, origins = cameras.axes[list(views)].double(), cameras.positions[list(views)].double()
    across = torch.eye(3, dtype=torch.float64) - axes[:, :, None] * axes[:, None, :]
    start = torch.zeros(3).double() if prior is None else prior.double()
    residual = (across @ (origins - start)[:, :, None]).sum(0)[:, 0]
    # The pseudoinverse leaves out directions that the axes do not determine, so that `start` stays
    # as it is along them. Axes that differ by less than a fraction of a degree count as parallel.
    point: Tensor = start + torch.linalg.pinv(across.sum(0), rtol=1e-5, hermitian=True) @ residual
    return point.float()


def orbit_box(cameras: Cameras, views: Sequence[int], extent: float) -> Float[Tensor, "2 3"]:
    """Compute the cube around the largest ball that every view shows whole.

    Its centre is the point that the cameras look at. Its half side is the minimum over the cameras
    of distance times sine of the narrowest half field of view, times `extent`.

    Args:
        cameras: The cameras.
        views: The training views.
        extent: How many times larger than that ball the cube is: 1 for an object, `ROOM_EXTENT` for
            a room.

    Returns:
        Lower and upper corner.

    Raises:
        NerfregError: If the cameras look at no common point.
    """
    center = look_at_point(cameras, views)
    distances = _distances_ahead(cameras, views, center)
    size = torch.tensor([cameras.width, cameras.height])
    half_fields = torch.atan(0.5 * size / cameras.focal[list(views)]).amin(-1)
    # The sine and not the tangent: a ball touches the sides of the field of view, not the image
    # plane.
    radius = (distances * half_fields.sin()).min()
    half_side = radius * extent
    return torch.stack((center - half_side, center + half_side))


def bounds_of_box(
    cameras: Cameras, views: Sequence[int], box: Float[Tensor, "2 3"]
) -> tuple[float, float]:
    """Compute the nearest and the farthest distance from cameras to the ball around a box.

    Args:
        cameras: The cameras.
        views: The views whose rays must reach all of the box.
        box: Lower and upper corner.

    Returns:
        Near and far.
    """
    center, reach = box.mean(0), float((box[1] - box[0]).norm()) / 2
    distances = (cameras.positions[list(views)] - center).norm(dim=-1)
    nearest, farthest = float(distances.min()), float(distances.max())
    return max(NEAREST * nearest, nearest - reach), farthest + reach


def depth_bounds(nearest: float, farthest: float) -> tuple[float, float]:
    """Return near and far planes around everything, given the least and greatest known depth."""
    return nearest * (1 - DEPTH_MARGIN), farthest * (1 + DEPTH_MARGIN)


def guess_depth_bounds(cameras: Cameras, views: Sequence[int]) -> tuple[float, float]:
    """Guess near and far planes of forward-facing cameras from where their axes meet.

    Args:
        cameras: The cameras.
        views: The training views.

    Returns:
        Near and far depth.

    Raises:
        NerfregError: If the cameras look at no common point.
    """
    distances = _distances_ahead(cameras, views, look_at_point(cameras, views))
    return UNKNOWN_DEPTHS[0] * float(distances.min()), UNKNOWN_DEPTHS[1] * float(distances.max())


def frustum(cameras: Cameras, view: int, depth: float) -> Float[Tensor, "4 3"]:
    """Project the corners of an image out into the world.

    Args:
        cameras: The cameras.
        view: The view.
        depth: Depth along the optical axis.

    Returns:
        The corners, in order around the image.
    """
    width, height = float(cameras.width), float(cameras.height)
    corners = torch.tensor([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    origins, directions = cameras.rays_through(torch.full((4,), view), corners)
    along: Tensor = depth / (directions @ cameras.axes[view])
    return origins + directions * along[:, None]


def frusta_box(
    cameras: Cameras, views: Sequence[int], near: float, far: float
) -> Float[Tensor, "2 3"]:
    """Compute the axis-aligned box of what cameras see between two depths.

    Args:
        cameras: The cameras.
        views: The views.
        near: Least depth along the optical axis.
        far: Greatest depth along the optical axis.

    Returns:
        Lower and upper corner.
    """
    corners = torch.cat([frustum(cameras, view, depth) for view in views for depth in (near, far)])
    return torch.stack((corners.amin(0), corners.amax(0)))


def ray_length(cameras: Cameras, views: Sequence[int], depth: float) -> float:
    """Compute the longest distance along a ray to the plane at a depth, through a corner.

    Args:
        cameras: The cameras.
        views: The views.
        depth: Depth of the plane along the optical axis.

    Returns:
        The distance.
    """
    lengths = [
        (frustum(cameras, view, depth) - cameras.positions[view]).norm(dim=-1).max()
        for view in views
    ]
    return float(torch.stack(lengths).max())


def _distances_ahead(
    cameras: Cameras, views: Sequence[int], point: Float[Tensor, " 3"]
) -> Float[Tensor, " views"]:
    offsets = point - cameras.positions[list(views)]
    distances: Tensor = offsets.norm(dim=-1)
    ahead = (offsets * cameras.axes[list(views)]).sum(-1)
    # Ahead by half the distance at least: a camera that looks 60 degrees past the point does not
    # look at it. NaN would pass this comparison, hence the first test.
    if not math.isfinite(float(distances.sum())) or bool((ahead <= 0.5 * distances).any()):
        raise NerfregError(
            "scene.box: the training cameras do not look at one place, which leaves the position "
            "of the scene unknown; give scene.box, scene.near and scene.far, or "
            "scene.layout=forward with scene.near and scene.far"
        )
    return distances
