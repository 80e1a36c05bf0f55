"""How long and with what a run trains."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nerfreg.errors import NerfregError, require_range

LARGEST = 1e6

HALVED = 1000
"""Steps of a run at whose end the learning rate is half of the first."""


@dataclass
class TrainConfig:
    """steps, seconds: the budget, whichever is spent first; schedules follow the share of it that is spent.

    rays: training rays in each step. threads: CPU threads; None: all (a sweep is faster with one job a core).
    quiet: no progress bar. check: look at what every hook returns, in every `check_every`-th step.
    """

    steps: int | None = 3000
    seconds: float | None = None
    rays: int = 1024
    threads: int | None = None
    quiet: bool = False
    check: bool = False
    check_every: int = 100

    def __post_init__(self) -> None:
        require_range("train", self, check_every=(1, math.inf))


@dataclass
class OptimConfig:
    """Adam, its learning rate decaying exponentially to `decay` times the first.

    decay: None makes it 1 / (1 + steps / 1000), of the steps of the whole run: a tenth after 9000, as in the authors'
    program, and more in a run that is too short to settle. ema: decay of the moving average of the weights that is
    evaluated and saved; 0 switches it off.

    One step moves a weight by about lr (1 - beta1) / sqrt((1 - beta2) (1 - beta1^2 / beta2)) at most, 2.4 lr by default
    (by Cauchy and Schwarz), whatever the gradients were, if beta1^2 < beta2. Hence this is demanded, and a limit to
    lr: then no gradient whose square is finite makes a weight that is not.
    """

    lr: float = 1e-2
    beta1: float = 0.9
    beta2: float = 0.99
    eps: float = 1e-15
    decay: float | None = None
    ema: float = 0.95

    def __post_init__(self) -> None:
        tame, below_one = (1e-20, LARGEST), (0, 0.9999)
        require_range("optim", self, lr=tame, eps=(1e-20, math.inf), decay=tame)
        require_range("optim", self, beta1=below_one, beta2=below_one, ema=below_one)
        if self.beta1 > 0 and self.beta1**2 >= self.beta2:
            raise NerfregError(
                f"optim.beta1={self.beta1}: its square must be below optim.beta2={self.beta2}, or steps have no limit"
            )

    def rate(self, fraction: float, steps: int) -> float:
        """The learning rate when that share is spent of a budget that has so many steps."""
        last = 1 / (1 + steps / HALVED) if self.decay is None else self.decay
        return self.lr * last**fraction
