"""The training of one run.

In the order in which a reader meets them:

- `config`: the budget and the optimizer.
- `trainer`: one training step, and everything that it needs.
- `budget`: how much of the run is done.
- `loss`: the colour error, and the terms of the plugins.
- `averaging`: the moving average of the weights.
- `checkpoint`: weights on disk.
- `faults`, `guard`: losses and gradients that are not finite, and what becomes of such steps.
- `contracts`, `checked_hooks`: verification of what every hook returns (`train.check=true`).
- `progress`: what is printed while a run trains.
- `memory`: the allocator, and the peak memory of the process.
"""

from nerfreg.training.config import OptimConfig, TrainConfig

__all__ = ["OptimConfig", "TrainConfig"]
