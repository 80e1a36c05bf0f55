"""Camera poses are refined together with the field (BARF)."""

from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor, nn

from nerfreg import Regularizer, Schedule, TrainedModule, hookimpl

BIBTEX = """@inproceedings{lin2021barf, title = {{BARF}: Bundle-Adjusting Neural Radiance Fields},
  author = {Lin, C.-H. and Ma, W.-C. and Torralba, A. and Lucey, S.}, year = {2021}}"""


class Corrections(nn.Module):
    """A rotation vector and a shift for each view, without what moves or scales all together."""

    def __init__(self, outwards: Tensor) -> None:
        super().__init__()
        self.values = nn.Parameter(torch.zeros(len(outwards) - 1, 6))
        self.register_buffer("outwards", nn.functional.normalize(outwards, dim=1), False)

    def forward(self) -> tuple[Tensor, Tensor]:
        own = self.values - self.values.mean(dim=0)
        turns, shifts = nn.functional.pad(own, (0, 0, 0, 1)).split(3, dim=1)  # last: of view -1
        shifts = shifts - self.outwards * (self.outwards * shifts).sum() / len(self.values)
        cross = torch.linalg.cross(torch.eye(3).to(turns)[None], turns[:, None])
        return torch.matrix_exp(cross), shifts


@dataclass
class PoseRefinement(Regularizer):
    """Poses of training views are refined with the field, coarse features first (BARF).

    Attributes:
        weight: There is no loss; 0 switches it off, anything else has no effect.
        lr_scale: Factor of the learning rate, in radians around the box's centre and half boxes.
        opening: Share of the budget after which the field has all features.
        every: Poses move in one of so many steps, since their gradient costs a third of a step.
    """

    lr_scale: float = 0.15
    opening: float = 0.5
    every: int = 2

    cite: ClassVar[str] = BIBTEX
    in_evaluation: ClassVar[tuple[str, ...]] = ("nerfreg_rays",)
    evaluation_note: ClassVar[str] = "Test poses are not aligned with the refined ones."

    @hookimpl
    def nerfreg_module(self, scene_info):
        self._center, self._unit = scene_info.center, scene_info.half_box
        outwards = scene_info.cameras.positions - self._center
        self._corrections = Corrections(nn.functional.pad(outwards, (0, 0, 0, 1)))
        pace = Schedule("piecewise", points=((0.05, 0.0), (0.15, 1.0), (1.0, 0.03)))
        return TrainedModule(self._corrections, self.lr_scale, schedule=pace)

    @hookimpl(wrapper=True)
    def nerfreg_rays(self, step):
        rays = yield
        with torch.set_grad_enabled(step.training and step.index % self.every == 0):
            turns, shifts = (part.to(rays.origins)[rays.view] for part in self._corrections())
        center = self._center.to(turns)
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
        return {"turn_degrees": float(turn.rad2deg()), "shift": self._unit * float(shift)}
