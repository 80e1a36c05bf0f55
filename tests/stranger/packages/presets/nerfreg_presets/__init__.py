from dataclasses import dataclass
from typing import Any, ClassVar

from nerfreg import Regularizer, hookimpl


@dataclass
class Dim(Regularizer):
    """Colours are dark, more so in forward-facing scenes."""

    weight: float = 0.5

    by_layout: ClassVar[dict[str, dict[str, Any]]] = {"forward": {"weight": 0.25}}
    cite: ClassVar[str] = "@misc{stranger2020dim, title = {Dim}}"

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"dim": rendering.rgb.mean()}
