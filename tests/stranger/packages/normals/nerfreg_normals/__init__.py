"""Smooth normals: the gradient of the density keeps its direction along a surface."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn.functional import normalize

from nerfreg import Regularizer, Rendering, Step, hookimpl


@dataclass
class NormalSmoothness(Regularizer):
    """Normals of a surface are like those nearby (UNISURF; normals as in Ref-NeRF).

    The normal is the negative gradient of the density, normalized. Two are compared: at places on
    opposite sides of the point where a ray meets the surface, which is at its expected depth.

    Attributes:
        weight: Factor of the mean squared difference of two normals, which is 4 at most.
        rays: How many rays of a step are used.
        radius: How far the places lie from that point in x, y and z (standard deviation), as a
            share of half the scene's box.
    """

    weight: float = 1e-3
    rays: int = 256
    radius: float = 0.01

    cite: ClassVar[str] = """@inproceedings{oechsle2021unisurf,
  title = {{UNISURF}: Unifying Neural Implicit Surfaces and Radiance Fields},
  author = {Oechsle, Michael and Peng, Songyou and Geiger, Andreas},
  booktitle = {ICCV}, year = {2021}}
@inproceedings{verbin2022refnerf,
  title = {{Ref-NeRF}: Structured View-Dependent Appearance for Neural Radiance Fields},
  author = {Verbin, Dor and Hedman, Peter and Mildenhall, Ben and Zickler, Todd and others},
  booktitle = {CVPR}, year = {2022}}"""

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Tensor]:
        rays, hits = rendering.rays, rendering.visible.nonzero().squeeze(1)
        order = torch.randperm(len(hits), generator=step.generator)[: self.rays]
        hits = hits[order.to(hits.device)]
        depth = rendering.depth[hits, None].detach()
        surface = (rays.origins[hits] + rays.directions[hits] * depth).detach()
        shift = torch.randn(len(hits), 3, generator=step.generator).to(surface)
        shift = shift * self.radius * step.scene.half_box
        # A gradient of a gradient: the weights are changed so that the normals turn.
        around = torch.cat([surface + shift, surface - shift])
        here, there = normalize(-step.field.density_gradient(around), dim=1).chunk(2)
        return {"normals": (here - there).square().sum() / max(len(hits), 1)}
