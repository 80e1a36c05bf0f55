"""LLFF (Mildenhall et al. 2019): `poses_bounds.npy` and folders of forward-facing photographs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.scenes.base import SceneConfig, assemble
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.checks import check_rigid, scene_folder
from nerfreg.scenes.images import check_headers, list_images, read_image
from nerfreg.scenes.poses import recenter
from nerfreg.scenes.scene import Scene


@dataclass
class LLFF(SceneConfig):
    """A folder of LLFF, with `poses_bounds.npy` and `images` or `images_<factor>`.

    The world is moved rigidly so that the average camera is at its origin. Its unit is kept.

    Attributes:
        factor: Read `images_<factor>`, or `images` if 1; None for the smallest images there are.
    """

    layout: str | None = "forward"
    factor: int | None = None

    def load(self) -> Scene:
        """Read the poses, and the headers of the images of the split."""
        folder = scene_folder(self.path)
        path = folder / "poses_bounds.npy"
        poses, sizes, focal, depths = _read_poses(path)
        images = _image_folder(folder, self.factor)
        # Rows have no names: the i-th belongs to the i-th image in the order of the file names.
        files = list_images(images)
        if len(files) != len(poses):
            raise NerfregError(
                f"{images}: holds {len(files)} images, but {path} has {len(poses)} poses"
            )
        split = self.after_holding_out(self.split_of_one(len(files)))
        header = check_headers([files[view] for view in (*split.train, *split.test)])
        # The file holds the size and the focal length of the photographs as they were taken. Both
        # axes get a scale of their own, since the smaller images have rounded sizes.
        scale = np.array([header.width, header.height]) / sizes
        cameras = Cameras(
            header.width,
            header.height,
            recenter(torch.from_numpy(poses)).float(),
            torch.from_numpy(focal[:, None] * scale).float(),
            torch.tensor([header.width / 2, header.height / 2]).expand(len(files), 2),
            torch.zeros(len(files), 5),
        )

        def read(view: int) -> Tensor:
            return read_image(files[view])

        # Training views alone: nothing about the test views may influence training.
        seen = depths[list(split.train)]
        return assemble(
            self,
            name=folder.resolve().name,
            cameras=cameras,
            split=split,
            labels=[file.stem for file in files],
            read_image=read,
            folder=folder,
            paths=files,
            has_alpha=header.has_alpha,
            layout="forward",
            depths=(float(seen.min()), float(seen.max())),
        )


class _PosesBounds(NamedTuple):
    """`poses_bounds.npy`: OpenGL poses, image sizes in pixels, least and greatest depths."""

    poses: Float[np.ndarray, "views 3 4"]
    sizes: Float[np.ndarray, "views 2"]
    focal: Float[np.ndarray, " views"]
    depths: Float[np.ndarray, "views 2"]


def _read_poses(path: Path) -> _PosesBounds:
    # A row holds a 3 x 5 matrix, whose last column is height, width and focal length, and two
    # depths.
    try:
        rows = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise NerfregError(f"{path}: missing") from None
    except (OSError, ValueError, EOFError) as error:
        raise NerfregError(f"{path}: cannot be read as a numpy array: {error}") from None
    if not isinstance(rows, np.ndarray) or rows.ndim != 2 or rows.shape[1] != 17 or not len(rows):
        raise NerfregError(
            f"{path}: must have shape (images, 17), not {getattr(rows, 'shape', None)}"
        )
    if rows.dtype.kind not in "fiu":
        raise NerfregError(f"{path}: must hold real numbers, not {rows.dtype}")
    rows = rows.astype(np.float64)
    matrices, depths = rows[:, :15].reshape(-1, 3, 5), rows[:, 15:]
    # The axes of LLFF point down, right and backwards.
    down, right, back, position = (matrices[:, :, column] for column in range(4))
    poses = np.stack((right, -down, back, position), axis=2)
    for index, pose in enumerate(poses):
        check_rigid(pose, f"{path}: row {index}")
    height, width, focal = matrices[:, :, 4].T
    if not (np.isfinite(rows).all() and (matrices[:, :, 4] > 0).all()):
        raise NerfregError(f"{path}: height, width and focal length must be positive in every row")
    if not ((depths[:, 0] > 0) & (depths[:, 0] < depths[:, 1])).all():
        raise NerfregError(
            f"{path}: the bounds (the last two columns) must be 0 < near < far in every row"
        )
    return _PosesBounds(poses, np.stack((width, height), axis=1), focal, depths)


def _image_folder(folder: Path, factor: int | None) -> Path:
    found = {1: folder / "images"} if (folder / "images").is_dir() else {}
    for path in folder.glob("images_*"):
        match = re.fullmatch(r"images_(\d+)", path.name)
        if match and path.is_dir():
            found[int(match[1])] = path
    if not found:
        raise NerfregError(f"{folder}: has no folder 'images' or 'images_<factor>'")
    factor = max(found) if factor is None else factor
    if factor not in found:
        raise NerfregError(
            f"scene.factor={factor}: {folder} has images for factor "
            f"{', '.join(map(str, sorted(found)))}"
        )
    return found[factor]
