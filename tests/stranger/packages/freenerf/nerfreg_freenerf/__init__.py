"""Sines and cosines in place of the hash grid, the fast ones later (FreeNeRF)."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor, nn

from nerfreg import Regularizer, hookimpl

BIBTEX = """@inproceedings{yang2023freenerf,
  title = {{FreeNeRF}: Improving Few-Shot Neural Rendering with Free Frequency Regularization},
  author = {Yang, Jiawei and Pavone, Marco and Wang, Yue},
  booktitle = {CVPR}, year = {2023}}"""


class Sinusoids(nn.Module):
    """From x in [0, 1]^3 to 2 x - 1, and sine and cosine of it times pi 2^k, the slowest first."""

    def __init__(self, frequencies: int) -> None:
        super().__init__()
        self.width = 3 + 6 * frequencies
        self.register_buffer("factors", math.pi * 2.0 ** torch.arange(frequencies), False)

    def forward(self, x: Tensor) -> Tensor:
        x = 2 * x - 1
        angles = self.factors[:, None] * x[:, None]  # (P, frequencies, 3)
        waves = torch.stack((angles.sin(), angles.cos()), dim=2)
        return torch.cat((x, waves.flatten(1)), dim=1)


@dataclass
class FreeNeRF(Regularizer):
    """Positions are encoded by sines and cosines, unmasked from slow to fast (FreeNeRF).

    Attributes:
        weight: There is no loss; 0 switches it off, anything else has no effect.
        frequencies: Number of octaves.
        duration: Share of the budget after which all of them are there.
    """

    frequencies: int = 8
    duration: float = 0.5

    cite: ClassVar[str] = BIBTEX
    # Weights of features that are masked are still random.
    in_evaluation: ClassVar[tuple[str, ...]] = ("nerfreg_encoder_input",)

    @hookimpl
    def nerfreg_encoder(self, which):
        return Sinusoids(self.frequencies) if which == "positions" else None

    @hookimpl(wrapper=True)
    def nerfreg_encoder_input(self, step):
        samples = yield
        share = min(step.fraction / self.duration, 1.0)
        return replace(samples, density_features=3 + (samples.density_width - 3) * share)
