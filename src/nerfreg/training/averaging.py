"""Exponential moving average of the weights."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn


class MovingAverage:
    """Exponential moving average of a module's parameters.

    average <- d * average + (1 - d) * weights, where d is `decay`, or (1 + n) / (10 + n) at the
    n-th update as long as that is smaller.

    Attributes:
        decay: Upper bound of d, in [0, 1). 0 keeps no copy: the average is the weights.
        parameters: The parameters, detached; they share memory with the module's.
        averages: Their averages; empty if `decay` is 0.
        updates: Number n of updates so far.
    """

    def __init__(self, module: nn.Module, decay: float) -> None:
        self.decay = decay
        self.parameters: list[Tensor] = [p.detach() for p in module.parameters()]
        self.averages = [p.clone() for p in self.parameters] if decay else []
        self.updates = 0

    @torch.no_grad()
    def update(self) -> None:
        """Take the present weights into the average."""
        if self.averages:
            self.updates += 1
            # A short memory at first, so that the random initial weights are soon forgotten.
            decay = min(self.decay, (1 + self.updates) / (10 + self.updates))
            # One pass over all parameters, because memory bandwidth is what limits the average.
            torch._foreach_lerp_(self.averages, self.parameters, 1 - decay)

    @contextmanager
    @torch.no_grad()
    def applied(self) -> Iterator[None]:
        """Give the module the averaged weights within this context, and its own again after it."""
        # The values are exchanged and not the tensors, because the optimizer and the field hold
        # references to the parameters.
        own = [p.clone() for p in self.parameters] if self.averages else []
        _copy(self.parameters, self.averages)
        try:
            yield
        finally:
            _copy(self.parameters, own)


def _copy(targets: list[Tensor], sources: list[Tensor]) -> None:
    if sources:
        torch._foreach_copy_(targets, sources)
