"""Options of training: the budget and the optimizer."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nerfreg.errors import NerfregError, require_range

LARGEST = 1e6
"""Upper limit of `optim.lr` and `optim.decay`, far beyond any useful one."""

HALVED = 1000
"""Number of steps of a run at whose end the learning rate is half of the initial one."""


@dataclass
class TrainConfig:
    """The budget of a run, the size of its steps, and what is verified and shown.

    Attributes:
        steps: Limit of the number of steps; None: no limit.
        seconds: Limit of the training time, in seconds; None: no limit. The run ends when the
            first of both limits is reached, and schedules follow the share that is spent.
        rays: Training rays in each step.
        threads: CPU threads; None: all. A sweep is faster with one job per core.
        quiet: Show no progress.
        check: Verify what every hook returns, in every `check_every`-th step.
        check_every: Distance between the steps that are verified.
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
    """Adam (Kingma and Ba 2015) with an exponentially decaying learning rate.

    If beta1^2 < beta2, which is demanded, one step moves a weight by at most about

        lr (1 - beta1) / sqrt((1 - beta2) (1 - beta1^2 / beta2))

    whatever the gradients were: apart from its bias correction, Adam divides a sum of gradients by
    the root of a sum of their squares, and the Cauchy-Schwarz inequality bounds the quotient. For
    the default values this is 2.4 lr. As `lr` is limited as well, no gradient whose square is
    finite can make a weight that is not.

    Attributes:
        lr: Initial learning rate.
        beta1: Decay of Adam's average of the gradient.
        beta2: Decay of Adam's average of its square.
        eps: Added by Adam to the root of that average.
        decay: Learning rate at the end of the run relative to the initial one; None:
            1 / (1 + steps / 1000) for the steps of the whole run, which is a tenth after 9000
            steps, as in the program of CombiNeRF's authors, and more in a shorter run.
        ema: Decay of the moving average of the weights, which is what is evaluated and saved; 0
            switches it off.
    """

    lr: float = 1e-2
    beta1: float = 0.9
    beta2: float = 0.99
    eps: float = 1e-15
    decay: float | None = None
    ema: float = 0.95

    def __post_init__(self) -> None:
        positive, below_one = (1e-20, LARGEST), (0, 0.9999)
        require_range("optim", self, lr=positive, eps=(1e-20, math.inf), decay=positive)
        require_range("optim", self, beta1=below_one, beta2=below_one, ema=below_one)
        # Otherwise the sum behind the bound above diverges, and a step may be arbitrarily long.
        # With beta1 = 0 there is no sum: a step is at most lr / sqrt(1 - beta2) long.
        if self.beta1 > 0 and self.beta1**2 >= self.beta2:
            raise NerfregError(
                f"optim.beta1={self.beta1}: its square must be below optim.beta2={self.beta2}, "
                "or the length of a step has no bound"
            )

    def rate(self, fraction: float, steps: int) -> float:
        """Return the learning rate of a step.

        Args:
            fraction: Share of the budget that is spent, 0 to 1.
            steps: Number of steps of the whole run.
        """
        # A short run loses sharpness if it slows down as much as a long one: on held-out views
        # 0.3 was best after about 2300 steps, and no better than 0.1 after 7000
        # (docs/performance.md).
        last = 1 / (1 + steps / HALVED) if self.decay is None else self.decay
        rate: float = self.lr * last**fraction
        return rate
