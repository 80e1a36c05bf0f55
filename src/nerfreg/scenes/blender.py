"""NeRF-Synthetic: `transforms_train.json`, `transforms_test.json` and images with alpha, as Blender renders them."""

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
from nerfreg.scenes.images import check_headers, find_image, read_image
from nerfreg.scenes.scene import Scene
from nerfreg.scenes.splits import Split


@dataclass
class Blender(SceneConfig):
    """A folder of NeRF-Synthetic. Views number the training frames first, then the test frames.

    factor: the images are made this many times smaller. `train` and `test` number the frames of their own files.
    """

    layout: str | None = "orbit"
    factor: int = 2

    def load(self) -> Scene:
        """Read both files of frames, and the headers of the images of the split."""
        folder = scene_folder(self.path)
        train_files, train_poses, angle = _read_frames(folder / "transforms_train.json")
        test_files, test_poses, _ = _read_frames(folder / "transforms_test.json")
        train, test = self.split_of_two(len(train_poses), len(test_poses))
        split = self.after_holding_out(
            Split(train, tuple(len(train_poses) + view for view in test))
        )
        files = train_files + test_files
        header = check_headers([files[view] for view in (*split.train, *split.test)])
        if not 1 <= self.factor <= min(header.width, header.height):
            raise NerfregError(
                f"scene.factor={self.factor}: must lie between 1 and the image size, {header.width} x {header.height}"
            )
        count = len(files)
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
