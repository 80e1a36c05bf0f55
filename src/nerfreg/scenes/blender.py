"""NeRF-Synthetic (Mildenhall et al. 2020): frames in two JSON files, and images with alpha."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nerfreg.errors import NerfregError
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
from nerfreg.scenes.images import check_factor, check_headers, find_image, read_image
from nerfreg.scenes.scene import Scene
from nerfreg.scenes.splits import Split


@dataclass
class Blender(SceneConfig):
    """A folder of NeRF-Synthetic, with `transforms_train.json` and `transforms_test.json`.

    Views number the training frames first, then the test frames. `train` and `test` number the
    frames of their own files.

    Attributes:
        factor: How many times smaller to make the images.
    """

    factor: int = 2

    def load(self) -> Scene:
        """Read both JSON files, and the headers of the images of the split."""
        folder = scene_folder(self.path)
        train_files, train_poses, angle = _read_frames(folder / "transforms_train.json")
        test_files, test_poses, _ = _read_frames(folder / "transforms_test.json")
        train, test = self.split_of_two(len(train_poses), len(test_poses))
        split = self.after_holding_out(
            Split(train, tuple(len(train_poses) + view for view in test))
        )
        files = train_files + test_files
        header = check_headers([files[view] for view in (*split.train, *split.test)])
        check_factor(self.factor, header.width, header.height)
        count = len(files)
        # From the original width and not the reduced one, which may be rounded down: dropping the
        # last columns of an image does not change its focal length, nor its centre below.
        focal = 0.5 * header.width / math.tan(0.5 * angle) / self.factor
        cameras = Cameras(
            header.width // self.factor,
            header.height // self.factor,
            torch.from_numpy(np.stack(train_poses + test_poses)).float(),
            torch.full((count, 2), focal),
            torch.tensor([header.width, header.height]).expand(count, 2) / (2 * self.factor),
            torch.zeros(count, 5),
        )

        def read(view: int) -> Tensor:
            return read_image(files[view], self.factor)

        return assemble(
            self,
            name=folder.resolve().name,
            cameras=cameras,
            split=split,
            labels=[file.relative_to(folder).with_suffix("").as_posix() for file in files],
            read_image=read,
            folder=folder,
            paths=files,
            has_alpha=header.has_alpha,
            layout="orbit",
        )


def _read_frames(path: Path) -> tuple[list[Path], list[Any], float]:
    content = read_json(path)
    angle = number(content, "camera_angle_x", str(path))
    if not 0 < angle < math.pi:
        raise NerfregError(f"{path}: 'camera_angle_x' is {angle}, but must lie between 0 and pi")
    files, poses = [], []
    for index, frame in enumerate(require_frames(content, path)):
        where = f"{path}: frame {index}"
        files.append(find_image(path.parent / str(require(frame, "file_path", where))))
        poses.append(frame_pose(frame, where))
    return files, poses, angle
