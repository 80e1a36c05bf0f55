"""Camera poses: 3 x 4 camera-to-world matrices with OpenGL axes (x right, y up, looking along -z)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def look_at(
    position: Float[np.ndarray, " 3"], target: Float[np.ndarray, " 3"], up: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "3 4"]:
    """The pose of an upright camera at `position` that looks at `target`."""
    return _frame(position - target, up, position)


def recenter(poses: Float[np.ndarray, "views 3 4"]) -> Float[np.ndarray, "views 3 4"]:
    """Move the world rigidly so that the average camera stands at the origin and looks along -z. Keeps its unit."""
    center = _frame(poses[:, :, 2].sum(0), poses[:, :, 1].sum(0), poses[:, :, 3].mean(0))
    rotation = center[:, :3].T
    moved: np.ndarray = rotation @ poses
    moved[:, :, 3] -= rotation @ center[:, 3]
    return moved


def _frame(
    back: Float[np.ndarray, " 3"], up: Float[np.ndarray, " 3"], position: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "3 4"]:
    z = back / np.linalg.norm(back)
    x = np.cross(up, z)
    x = x / np.linalg.norm(x)
    return np.stack((x, np.cross(z, x), z, position), axis=1)
