"""`transforms.json` as instant-ngp and nerfstudio write it, with lens distortion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.scenes import lens
from nerfreg.scenes.base import SceneConfig, assemble
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.checks import (
    frame_pose,
    number,
    read_json,
    require,
    require_frames,
    scene_folder,
)
from nerfreg.scenes.images import (
    ImageHeader,
    check_factor,
    check_headers,
    find_image,
    read_image,
)
from nerfreg.scenes.scene import Scene
from nerfreg.scenes.splits import Split, evenly

CAMERA_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
"""COLMAP's camera models that are special cases of OpenCV's distortion: coefficients that a model
does not have are absent from the file, and 0."""

DISTORTION = ("k1", "k2", "p1", "p2", "k3")
"""Keys of the distortion coefficients, in OpenCV's order."""

INVERSION_TOLERANCE = 0.1
"""Pixels by which undistorted rays may miss, anywhere in the image."""


@dataclass
class Transforms(SceneConfig):
    """A `transforms.json`, or the folder that holds it.

    Views number its frames, in their order. `split: null` uses the file's own lists of training and
    test images if there are any, and every_8 otherwise. `layout: null` looks at the cameras.

    Attributes:
        factor: How many times smaller to make the images.
    """

    factor: int = 1

    def load(self) -> Scene:
        """Read the JSON file, and the headers of the images of the split."""
        path = scene_folder(self.path)
        path = path / "transforms.json" if path.is_dir() else path
        content = read_json(path)
        frames = require_frames(content, path)
        names = [
            str(require(frame, "file_path", f"{path}: frame {i}")) for i, frame in enumerate(frames)
        ]
        files = [find_image(path.parent / name) for name in names]
        poses = np.stack(
            [frame_pose(frame, f"{path}: frame {i}") for i, frame in enumerate(frames)]
        )
        split = self.after_holding_out(self._split(content, names, path))
        header = check_headers([files[view] for view in (*split.train, *split.test)])
        check_factor(self.factor, header.width, header.height)
        # The keys of a frame take precedence over those of the file: nerfstudio writes intrinsics
        # into the frames where the cameras differ.
        lenses = torch.tensor(
            [
                _intrinsics({**content, **frame}, header, f"{path}: frame {i}")
                for i, frame in enumerate(frames)
            ]
        )
        cameras = Cameras(
            header.width // self.factor,
            header.height // self.factor,
            torch.from_numpy(poses).float(),
            lenses[:, 0:2] / self.factor,
            lenses[:, 2:4] / self.factor,
            lenses[:, 4:],
        )
        _check_invertible(cameras, split, path)

        def read(view: int) -> Tensor:
            return read_image(files[view], self.factor)

        return assemble(
            self,
            name=path.resolve().parent.name,
            cameras=cameras,
            split=split,
            labels=[PurePosixPath(name).as_posix() for name in names],
            read_image=read,
            folder=path.parent,
            paths=files,
            has_alpha=header.has_alpha,
        )

    def _split(self, content: dict[str, Any], names: list[str], path: Path) -> Split:
        chosen = self.split is not None or self.train is not None or self.test is not None
        if chosen or "train_filenames" not in content:
            return self.split_of_one(len(names))
        index = {PurePosixPath(name): view for view, name in enumerate(names)}

        def views(key: str) -> tuple[int, ...]:
            listed = [PurePosixPath(str(name)) for name in content.get(key) or ()]
            for name in listed:
                if name not in index:
                    raise NerfregError(
                        f"{path}: '{key}' names {name}, which is the file_path of no frame"
                    )
            return tuple(index[name] for name in listed)

        # Some files list validation images, but no test images.
        train, test = views("train_filenames"), views("test_filenames") or views("val_filenames")
        if not train or not test:
            raise NerfregError(
                f"{path}: 'train_filenames' and 'test_filenames' must both name images; "
                "or set scene.split=every_8, or scene.train and scene.test"
            )
        return Split(evenly(train, self.views), test)


def _intrinsics(values: dict[str, Any], header: ImageHeader, where: str) -> list[float]:
    """fx, fy, cx, cy in pixels of the image files, and the five distortion coefficients."""
    model = str(values.get("camera_model", "OPENCV"))
    # k4 belongs to fisheye models alone; colmap2nerf.py marks these by `is_fisheye` instead.
    if model not in CAMERA_MODELS or values.get("is_fisheye") or float(values.get("k4") or 0) != 0:
        name = model if model not in CAMERA_MODELS else "fisheye (is_fisheye or k4)"
        raise NerfregError(
            f"{where}: camera model {name} is not supported, only "
            f"{', '.join(CAMERA_MODELS)}; undistort the images first"
        )
    width = number(values, "w", where) if "w" in values else float(header.width)
    height = number(values, "h", where) if "h" in values else float(header.height)
    # The images may have been made smaller since the file was written. Their height then agrees
    # with that of the file but for rounding.
    scale = header.width / width, header.height / height
    if abs(scale[0] * height - header.height) > 1.5 or min(scale) <= 0:
        raise NerfregError(
            f"{where}: 'w' and 'h' are {width:g} x {height:g}, but the images are "
            f"{header.width} x {header.height}, not a smaller version of that; correct 'w' and 'h'"
        )
    fx = _focal(values, "x", width, where)
    fy = (
        _focal(values, "y", height, where) if "fl_y" in values or "camera_angle_y" in values else fx
    )
    if fx is None or fy is None:
        raise NerfregError(
            f"{where}: both 'fl_x' and 'camera_angle_x' are missing; one of them is needed"
        )
    cx = number(values, "cx", where) if "cx" in values else width / 2
    cy = number(values, "cy", where) if "cy" in values else height / 2
    distortion = [number(values, key, where) if key in values else 0.0 for key in DISTORTION]
    return [fx * scale[0], fy * scale[1], cx * scale[0], cy * scale[1], *distortion]


def _focal(values: dict[str, Any], axis: str, size: float, where: str) -> float | None:
    if f"fl_{axis}" in values:
        focal = number(values, f"fl_{axis}", where)
    elif f"camera_angle_{axis}" in values:
        focal = 0.5 * size / math.tan(0.5 * number(values, f"camera_angle_{axis}", where))
    else:
        return None
    if not (focal > 0 and math.isfinite(focal)):
        raise NerfregError(
            f"{where}: the focal length along {axis} is {focal:g}, but must be positive"
        )
    return focal


def _check_invertible(cameras: Cameras, split: Split, path: Path) -> None:
    # Points all over the image: where distortion folds, it need not do so in the corners alone.
    width, height = float(cameras.width), float(cameras.height)
    border = torch.tensor([[x * width / 4, y * height / 4] for x in range(5) for y in range(5)])
    for view in (*split.train, *split.test):
        coefficients = cameras.distortion[view].expand(len(border), 5)
        points = (border - cameras.center[view]) / cameras.focal[view]
        if not lens.invertible(
            points, coefficients, INVERSION_TOLERANCE / float(cameras.focal[view].max())
        ):
            raise NerfregError(
                f"{path}: frame {view}: the distortion {', '.join(DISTORTION)} = "
                f"{', '.join(f'{c:g}' for c in cameras.distortion[view].tolist())} "
                "folds the image over itself"
            )
