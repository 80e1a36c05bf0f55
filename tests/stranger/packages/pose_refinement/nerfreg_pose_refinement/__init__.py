"""Camera poses are refined together with the field (BARF)."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import nn

from nerfreg import Regularizer, Schedule, TrainedModule, hookimpl

BIBTEX = """@inproceedings{lin2021barf,
  title = {{BARF}: Bundle-Adjusting Neural Radiance Fields},
  author = {Lin, Chen-Hsuan and Ma, Wei-Chiu and Torralba, Antonio and Lucey, Simon},
  booktitle = {ICCV}, year = {2021}}"""


class Corrections(nn.Module):
    """A rotation vector and a shift, in half boxes, for each view but the first, which stays."""

    def __init__(self, views: int) -> None:
        super().__init__()
        self.values = nn.Parameter(torch.zeros(views - 1, 6))

    def forward(self):
        # One by the number of the view: the first one and -1, all other cameras, stay.
        turns, shifts = nn.functional.pad(self.values, (0, 0, 1, 1)).split(3, dim=1)
        axes = torch.eye(3, device=turns.device).expand(len(turns), 3, 3)
        cross = torch.linalg.cross(turns[:, :, None].expand_as(axes), axes, dim=1)
        return torch.matrix_exp(cross), shifts


@dataclass
class PoseRefinement(Regularizer):
    """Poses of all training views but the first are refined, coarse features first (BARF).

    Attributes:
        weight: There is no loss; 0 switches it off, anything else has no effect.
        lr_scale: Factor of the learning rate for poses, in radians and half boxes.
        opening: Share of the budget after which the field has all features.
    """

    lr_scale: float = 0.1
    opening: float = 0.4
    wait: float = 0.15

    cite: ClassVar[str] = BIBTEX
    in_evaluation: ClassVar[tuple[str, ...]] = ("nerfreg_rays",)
    evaluation_note: ClassVar[str] = "Test poses are not aligned with the refined training poses."

    @hookimpl
    def nerfreg_module(self, scene_info):
        self._corrections = Corrections(len(scene_info.cameras))
        self._center, self._unit = scene_info.center, scene_info.half_box
        # Not before there is something to see: Adam makes full steps of the noise, too.
        pace = Schedule("piecewise", points=((self.wait, 0.0), (self.wait + 0.1, 1.0), (1.0, 0.03)))
        return TrainedModule(self._corrections, self.lr_scale, schedule=pace)

    @hookimpl(wrapper=True)
    def nerfreg_rays(self):
        rays = yield
        turns, shifts = self._corrections()
        center, turns, shifts = self._center.to(turns), turns[rays.view], shifts[rays.view]
        # Around the scene's centre, which then stays in its place in the image: turns and shifts
        # are nearly independent, and Adam treats each at its own scale.
        directions = (turns @ rays.directions[..., None])[..., 0]
        arms = (turns @ (rays.origins - center)[..., None])[..., 0]
        return replace(rays, origins=center + arms + self._unit * shifts, directions=directions)

    @hookimpl(wrapper=True)
    def nerfreg_encoder_input(self, step):
        samples = yield
        share = 0.25 + 0.75 * min(step.fraction / self.opening, 1.0)
        return replace(samples, density_features=samples.density_width * share)

    @hookimpl
    def nerfreg_metrics(self):
        turn, shift = self._corrections.values.detach().view(-1, 2, 3).norm(dim=2).mean(dim=0)
        return {"turn_degrees": math.degrees(turn), "shift": self._unit * float(shift)}
