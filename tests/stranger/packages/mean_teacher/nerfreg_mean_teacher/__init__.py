"""The moving average of the weights teaches the field on views that no photograph shows."""

import math
from dataclasses import dataclass
from typing import ClassVar

from nerfreg import Needs, Regularizer, hookimpl

BIBTEX = """@inproceedings{tarvainen2017meanteacher,
  title = {Mean teachers are better role models},
  author = {Tarvainen, Antti and Valpola, Harri}, booktitle = {NeurIPS}, year = {2017}}
@inproceedings{zhao2025segs,
  title = {Self-Ensembling {Gaussian} Splatting for Few-Shot Novel View Synthesis},
  author = {Zhao, Chen and Wang, Xuan and Zhang, Tong and Javed, Saqib and Salzmann, Mathieu},
  booktitle = {ICCV}, year = {2025}}"""


@dataclass
class MeanTeacher(Regularizer):
    """Unseen rays look as the moving average of the weights renders them (SE-GS, 2025).

    A ray counts less the further it is from what student and teacher usually disagree by: where
    they differ much, neither of them knows.

    Attributes:
        weight: Our own.
        share: Share of a step's rays that are unseen. They take the place of training rays.
        warmup: Number of steps over which the term grows to its full size.
        memory: Decay of the moving average of the usual disagreement.
    """

    weight: float = 0.1
    share: float = 0.25
    warmup: int = 200
    memory: float = 0.9

    cite: ClassVar[str] = BIBTEX

    def __post_init__(self) -> None:
        self._steps, self._usual, self._latest = 0, None, None

    @hookimpl
    def nerfreg_needs(self):
        return Needs(unseen_rays=self.share)

    @hookimpl
    def nerfreg_loss(self, rendering, step):
        student = rendering.picked(rendering.rays.unseen)
        teacher = step.teacher.rerender(student)
        error = (student.rgb - teacher.rgb).square().mean(dim=1)
        self._latest = float(error.detach().mean())
        usual = self._usual or math.inf
        trust = (-error.detach() / usual).exp() * min((self._steps + 1) / self.warmup, 1.0)
        return {"consistency": (trust * error).mean()}

    @hookimpl
    def nerfreg_step_end(self):
        usual = self._latest if self._usual is None else self._usual
        self._usual = self.memory * usual + (1 - self.memory) * self._latest
        self._steps += 1

    def state_dict(self):
        return {"steps": self._steps, "usual": self._usual}

    def load_state_dict(self, state):
        self._steps, self._usual = state["steps"], state["usual"]
