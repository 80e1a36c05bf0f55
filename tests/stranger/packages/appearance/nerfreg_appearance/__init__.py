"""Each photograph has an appearance of its own, such as its exposure (NeRF-W)."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import nn

from nerfreg import Regularizer, TrainedModule, hookimpl

BIBTEX = """@inproceedings{martinbrualla2021nerfw,
  title = {{NeRF} in the Wild: Neural Radiance Fields for Unconstrained Photo Collections},
  author = {Martin-Brualla, Ricardo and Radwan, Noha and Sajjadi, Mehdi S. M. and Barron,
    Jonathan T. and Dosovitskiy, Alexey and Duckworth, Daniel},
  booktitle = {CVPR}, year = {2021}}"""


@dataclass
class Appearance(Regularizer):
    """Colours depend on a vector that is learned for each training view (NeRF-W).

    All other views are rendered with the mean of these vectors.

    Attributes:
        weight: There is no loss; 0 switches it off, anything else has no effect.
        features: Length of the vectors.
        lr_scale: Factor of the learning rate for them.
    """

    features: int = 4
    lr_scale: float = 0.3

    cite: ClassVar[str] = BIBTEX

    @property
    def color_inputs(self) -> int:
        """How many features the colour network gets."""
        return self.features

    @hookimpl
    def nerfreg_module(self, scene_info):
        self._vectors = nn.Embedding(len(scene_info.cameras), self.features)
        # All alike at first: the mean is then, and stays, among what the network has learned.
        nn.init.zeros_(self._vectors.weight)
        return TrainedModule(self._vectors, lr_scale=self.lr_scale)

    @hookimpl
    def nerfreg_color_input(self, samples):
        vectors = self._vectors.weight
        # The mean comes last, where view -1 finds it.
        rows = torch.cat((vectors, vectors.mean(dim=0, keepdim=True)))
        return rows[samples.view].to(samples.t)
