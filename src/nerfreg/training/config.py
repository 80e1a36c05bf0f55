"""How long and with what a run trains."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nerfreg.errors import require_range


@dataclass
class TrainConfig:
    """steps, seconds: the budget, whichever is spent first; schedules follow the share of it that is spent.

    rays: training rays in each step. threads: CPU threads; None: all (a sweep is faster with one job a core).
    quiet: no progress bar.
    """

    steps: int | None = 3000
    seconds: float | None = None
    rays: int = 1024
    threads: int | None = None
    quiet: bool = False


@dataclass
class OptimConfig:
    """Adam, its learning rate decaying exponentially to `decay` times the first.

    ema: decay of the moving average of the weights that is evaluated and saved; 0 switches it off.
    """

    lr: float = 1e-2
    beta1: float = 0.9
    beta2: float = 0.99
    eps: float = 1e-15
    decay: float = 0.1
    ema: float = 0.95

    def __post_init__(self) -> None:
        positive, below_one = (1e-20, math.inf), (0, 0.9999)
        require_range("optim", self, lr=positive, eps=positive, decay=positive)
        require_range("optim", self, beta1=below_one, beta2=below_one, ema=below_one)
