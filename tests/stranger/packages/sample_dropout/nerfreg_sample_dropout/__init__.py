"""Dropout of samples: what is behind a surface is trained, too, when the surface is left out."""

from collections.abc import Generator
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from nerfreg import DensitySamples, Regularizer, Step, hookimpl


@dataclass
class SampleDropout(Regularizer):
    """Random samples are left out in training, and the others made denser (DropGaussian 2025).

    As in the paper, the rate rises linearly over the run, and what remains is divided by 1 - rate,
    so that the optical thickness of a ray stays the same on average. Evaluation leaves out nothing.

    Attributes:
        weight: 0 switches the dropout off; other values make no difference.
        rate: Share of the samples that is left out at the end of the run.
        cells: Cells per side of a grid around the scene's box. A cell is left out as a whole, for
            all rays of the step, as a Gaussian is; 0: each sample for itself.
    """

    rate: float = 0.2
    cells: int = 0

    cite: ClassVar[str] = """@inproceedings{park2025dropgaussian,
  title = {{DropGaussian}: Structural Regularization for Sparse-view {Gaussian} Splatting},
  author = {Park, Hyunwoo and Ryu, Gun and Kim, Wonjun},
  booktitle = {CVPR}, year = {2025}}"""

    @hookimpl(wrapper=True)
    def nerfreg_density(
        self, samples: DensitySamples, step: Step
    ) -> Generator[None, Tensor, Tensor]:
        density = yield
        rate = self.rate * step.fraction
        shape = (self.cells**3,) if self.cells else tuple(density.shape)
        factor = (torch.rand(shape, generator=step.generator) >= rate) / (1 - rate)
        factor = factor.to(density)
        if self.cells:
            cell = (step.scene.unit(samples.positions) * self.cells).long()
            x, y, z = cell.clamp(0, self.cells - 1).unbind(-1)
            factor = factor[x + self.cells * (y + self.cells * z)]
        return density * factor
