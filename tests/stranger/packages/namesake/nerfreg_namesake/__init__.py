from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from nerfreg import Regularizer, hookimpl


@dataclass
class Other(Regularizer):
    """Opacity is small; it has the name of one of ours."""

    weight: float = 0.5
    power: float = 2.0
    reduction: Literal["mean", "sum"] = "mean"

    by_layout: ClassVar[dict[str, dict[str, Any]]] = {"forward": {"weight": 0.25}}
    cite: ClassVar[str] = "@misc{stranger2021other, title = {Other}}"
    schedulable: ClassVar[tuple[str, ...]] = ("power",)
    evaluation_note: ClassVar[str] = "Scores are those of a namesake."

    def __post_init__(self):
        if self.power < 1:
            raise ValueError("power is below 1")

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"opacity": rendering.opacity.pow(self.power).mean()}
