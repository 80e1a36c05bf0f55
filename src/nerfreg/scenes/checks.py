"""Checks of names, files and poses at the border, which say what is wrong and where."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from nerfreg.errors import NerfregError, nearest

RIGID_TOLERANCE = 1e-3
"""How far products of a pose's axes may be from those of an orthonormal frame. Files hold rounded
decimals; anything larger is a scale or a shear, with which distances along rays would be wrong."""


def check_choice(key: str, value: str, choices: Sequence[str]) -> str:
    """Check that a value is one of several choices.

    Args:
        key: The key of the configuration, for the message.
        value: The value.
        choices: What it may be.

    Returns:
        The value.

    Raises:
        NerfregError: If it is none of the choices. The message names the nearest one.
    """
    if value in choices:
        return value
    raise NerfregError(
        f"{key}={value}: unknown; {nearest(value, choices)} (one of {', '.join(choices)})"
    )


def scene_folder(path: str | None) -> Path:
    """Find the folder or file that `scene.path` names.

    Args:
        path: The value of the key, in which "~" is the home directory.

    Returns:
        The path.

    Raises:
        NerfregError: If it is not set or does not exist.
    """
    if not path:
        raise NerfregError(
            "scene.path: not set; give the folder of the scene, e.g. scene.path=data/fern"
        )
    folder = Path(path).expanduser()
    if not folder.exists():
        raise NerfregError(f"scene.path={path}: no such file or folder")
    return folder


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object from a file.

    Args:
        path: The file.

    Returns:
        The object.

    Raises:
        NerfregError: If the file is missing or holds anything else.
    """
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
    """Return the value of a required key.

    Args:
        content: The object that must have the key.
        key: The key.
        where: The file, and the frame if the object is one, for the message.

    Returns:
        The value.

    Raises:
        NerfregError: If the key is missing.
    """
    if key not in content:
        raise NerfregError(f"{where}: key '{key}' is missing")
    return content[key]


def require_frames(content: dict[str, Any], path: Path) -> list[dict[str, Any]]:
    """Return the frames of a transforms file.

    Args:
        content: The content of the file.
        path: The file, for the message.

    Returns:
        The frames, at least one.

    Raises:
        NerfregError: If there is none, or they are not a list of objects.
    """
    frames = require(content, "frames", str(path))
    if (
        not isinstance(frames, list)
        or not frames
        or not all(isinstance(frame, dict) for frame in frames)
    ):
        raise NerfregError(f"{path}: 'frames' must be a list of at least one frame")
    return frames


def number(content: dict[str, Any], key: str, where: str) -> float:
    """Return the finite number at a required key.

    Args:
        content: The object that must have the key.
        key: The key.
        where: The file, and the frame if the object is one, for the message.

    Returns:
        The number.

    Raises:
        NerfregError: If the key is missing, or its value is no finite number.
    """
    value = require(content, key, where)
    # A bool is an int in Python, and JSON as Python reads it may hold NaN and Infinity.
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise NerfregError(f"{where}: '{key}' must be a number, not {value!r}")
    return float(value)


def frame_pose(frame: dict[str, Any], where: str) -> Float[np.ndarray, "3 4"]:
    """Return the camera-to-world matrix of a frame of a transforms file.

    Args:
        frame: The frame.
        where: The file and the frame, for the message.

    Returns:
        The matrix, in double precision.

    Raises:
        NerfregError: If it is missing, has another shape, or is not rigid.
    """
    matrix = require(frame, "transform_matrix", where)
    try:
        pose = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        raise NerfregError(f"{where}: 'transform_matrix' must be 4 x 4 numbers") from None
    if pose.shape not in ((4, 4), (3, 4)):
        raise NerfregError(f"{where}: 'transform_matrix' must be 4 x 4 numbers, not {pose.shape}")
    return check_rigid(pose[:3], where)


def check_rigid(pose: Float[np.ndarray, "3 4"], where: str) -> Float[np.ndarray, "3 4"]:
    """Check that a pose is a rotation followed by a translation.

    Args:
        pose: The pose.
        where: The file, and the frame or row, for the message.

    Returns:
        The pose.

    Raises:
        NerfregError: If it is not finite, scales, shears or mirrors.
    """
    if not np.isfinite(pose).all():
        raise NerfregError(f"{where}: the pose holds NaN or infinity")
    rotation = pose[:, :3]
    error = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if error > RIGID_TOLERANCE:
        raise NerfregError(
            f"{where}: the pose is not rigid; its axes deviate from orthonormal by {error:.2g}"
        )
    # A mirrored frame is orthonormal, too: as a rule an axis was flipped in a conversion.
    if np.linalg.det(rotation) < 0:
        raise NerfregError(f"{where}: the pose is not rigid; it mirrors (determinant -1)")
    return pose
