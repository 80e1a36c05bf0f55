"""The folder of real data, and a small scene of each format that reads files."""

from __future__ import annotations

import json
import os
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest


@pytest.fixture(scope="session")
def data() -> Path:
    if not os.environ.get("NERFREG_DATA"):
        pytest.skip("NERFREG_DATA is not set: no real photographs to test with")
    return Path(os.environ["NERFREG_DATA"])


def write_image(path: Path, width: int, height: int, channels: int = 3, value: int = 128) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    iio.imwrite(path, np.full((height, width, channels), value, np.uint8))


def pose_at(x: float) -> list[list[float]]:
    """A pose at (x, 0, 2) that looks along -z."""
    return [[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]


@pytest.fixture
def transforms(tmp_path: Path) -> Path:
    """Nine images of 8 x 6 pixels from cameras in a row that look along -z."""
    frames = []
    for index in range(9):
        write_image(tmp_path / "images" / f"{index}.png", 8, 6)
        frames.append(
            {"file_path": f"images/{index}.png", "transform_matrix": pose_at(0.1 * index)}
        )
    content = {"fl_x": 10.0, "fl_y": 12.0, "cx": 3.5, "cy": 2.5, "w": 8, "h": 6, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    return tmp_path / "transforms.json"


@pytest.fixture
def blender(tmp_path: Path) -> Path:
    """Two training and two test frames of 8 x 8 pixels.

    Opposite pairs of cameras look at the origin from a distance of 2.
    """
    turned = [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, -2], [0, 0, 0, 1]]
    for part in ("train", "test"):
        frames = [
            {"file_path": f"./{part}/r_{index}", "transform_matrix": pose}
            for index, pose in enumerate((pose_at(0), turned))
        ]
        for index in range(2):
            write_image(tmp_path / part / f"r_{index}.png", 8, 8, 4)
        content = {"camera_angle_x": np.pi / 2, "frames": frames}
        (tmp_path / f"transforms_{part}.json").write_text(json.dumps(content))
    return tmp_path


@pytest.fixture
def llff(tmp_path: Path) -> Path:
    """Three images of 8 x 6 pixels for photographs of 80 x 60, by cameras in a row along x."""
    rows = []
    for index in range(3):
        # Columns: down = -y, right = x, backwards = z, position, (height, width, focal).
        matrix = np.array([[0, 1, 0, index, 60], [-1, 0, 0, 0, 80], [0, 0, 1, 0, 100]], float)
        rows.append([*matrix.ravel(), 2.0 - 0.5 * index, 10.0 + index])
        write_image(tmp_path / "images_10" / f"{index}.png", 8, 6)
    np.save(tmp_path / "poses_bounds.npy", np.array(rows))
    return tmp_path
