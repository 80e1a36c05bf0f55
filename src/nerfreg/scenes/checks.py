"""What stands at the border: checks of names, files and poses that say what is wrong and where."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from nerfreg.errors import NerfregError, nearest

RIGID_TOLERANCE = 1e-3


def check_choice(key: str, value: str, choices: Sequence[str]) -> str:
    """Return `value` if it is one of `choices`; otherwise name the nearest one."""
    if value in choices:
        return value
    raise NerfregError(
        f"{key}={value}: unknown; {nearest(value, choices)} (one of {', '.join(choices)})"
    )


def scene_folder(path: str | None) -> Path:
    """The folder or file that `scene.path` names."""
    if not path:
        raise NerfregError(
            "scene.path: not set; say where the scene lies, e.g. scene.path=data/fern"
        )
    folder = Path(path).expanduser()
    if not folder.exists():
        raise NerfregError(f"scene.path={path}: no such file or folder")
    return folder


def read_json(path: Path) -> dict[str, Any]:
    """The JSON object in a file."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise NerfregError(f"{path}: missing") from None
    except (OSError, ValueError) as error:
        raise NerfregError(f"{path}: cannot be read as JSON: {error}") from None
    if not isinstance(content, dict):
        raise NerfregError(f"{path}: must hold a JSON object, not a {type(content).__name__}")
    return content


def require(content: dict[str, Any], key: str, where: str) -> Any:
    """The value of a key that must be there. where: the file, and the frame if it is inside one."""
    if key not in content:
        raise NerfregError(f"{where}: key '{key}' is missing")
    return content[key]


def require_frames(content: dict[str, Any], path: Path) -> list[dict[str, Any]]:
    """The frames of a transforms file, at least one."""
    frames = require(content, "frames", str(path))
    if (
        not isinstance(frames, list)
        or not frames
        or not all(isinstance(frame, dict) for frame in frames)
    ):
        raise NerfregError(f"{path}: 'frames' must be a list of at least one frame")
    return frames


def number(content: dict[str, Any], key: str, where: str) -> float:
    """The finite number that stands at a key."""
    value = require(content, key, where)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise NerfregError(f"{where}: '{key}' must be a number, not {value!r}")
    return float(value)


def frame_pose(frame: dict[str, Any], where: str) -> Float[np.ndarray, "3 4"]:
    """The camera-to-world matrix of a frame of a transforms file, checked."""
    matrix = require(frame, "transform_matrix", where)
    try:
        pose = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        raise NerfregError(f"{where}: 'transform_matrix' must be 4 x 4 numbers") from None
    if pose.shape not in ((4, 4), (3, 4)):
        raise NerfregError(f"{where}: 'transform_matrix' must be 4 x 4 numbers, not {pose.shape}")
    return check_rigid(pose[:3], where)


def check_rigid(pose: Float[np.ndarray, "3 4"], where: str) -> Float[np.ndarray, "3 4"]:
    """Return `pose` if it is finite, and a rotation followed by a shift."""
    if not np.isfinite(pose).all():
        raise NerfregError(f"{where}: the pose holds NaN or infinity")
    rotation = pose[:, :3]
    error = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if error > RIGID_TOLERANCE:
        raise NerfregError(
            f"{where}: the pose is not rigid; its axes are off orthonormal by {error:.2g}"
        )
    if np.linalg.det(rotation) < 0:
        raise NerfregError(f"{where}: the pose is not rigid; it mirrors (determinant -1)")
    return pose
