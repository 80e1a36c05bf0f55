"""Total variation of the hash grid: neighbouring vertices have similar features."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from nerfreg import Regularizer, Rendering, Step, hookimpl


@dataclass
class GridTV(Regularizer):
    """Features of the hash grid change little from vertex to vertex (VGOS, NeurTV).

    As in VGOS, the root of the squared differences along x, y and z is averaged over cells, here
    over cells around random points in the scene's box. All levels count alike.

    Attributes:
        weight: Factor of the term; features of a trained grid are of the order of 1.
        points: Number of points in a step; each has a cell in every level.
    """

    weight: float = 1e-3
    points: int = 2048

    cite: ClassVar[str] = """@inproceedings{sun2023vgos,
  title = {{VGOS}: Voxel Grid Optimization for View Synthesis from Sparse Inputs},
  author = {Sun, Jiakai and Zhang, Zhanjie and Chen, Jiafu and Li, Guangyuan and others},
  booktitle = {IJCAI}, year = {2023}}
@article{luo2024neurtv,
  title = {{NeurTV}: Total Variation on the Neural Domain},
  author = {Luo, Yisi and Zhao, Xile and Ye, Kai and Meng, Deyu},
  journal = {arXiv:2405.17241}, year = {2024}}"""

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Tensor]:
        low, high = step.scene.box
        points = torch.lerp(low, high, torch.rand(self.points, 3, generator=step.generator))
        places = step.scene.unit(points).to(rendering.depth.device).clamp(0, 1 - 1e-6)
        squares = [
            level.squared_differences((places * level.resolution).int())
            for level in step.field.tables
        ]
        # Not the root of 0, whose slope is infinite.
        return {"grid_tv": torch.cat(squares).clamp_min(1e-12).sqrt().mean()} if squares else {}
