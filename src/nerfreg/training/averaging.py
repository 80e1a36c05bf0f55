"""Exponential moving average of the weights."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn


class MovingAverage:
    """average <- decay * average + (1 - decay) * weights, with a shorter memory while there are few steps.

    A decay of 0 keeps no copy: the average is the weights.
    """

    def __init__(self, module: nn.Module, decay: float) -> None:
        self.decay = decay
        self.parameters: list[Tensor] = [p.detach() for p in module.parameters()]
        self.averages = [p.clone() for p in self.parameters] if decay else []
        self.updates = 0

    @torch.no_grad()
    def update(self) -> None:
        """Take the weights of this step into the average."""
        if self.averages:
            self.updates += 1
            decay = min(self.decay, (1 + self.updates) / (10 + self.updates))
            torch._foreach_lerp_(self.averages, self.parameters, 1 - decay)

    @contextmanager
    @torch.no_grad()
    def applied(self) -> Iterator[None]:
        """The module has the averaged weights inside the block, and its own again after it."""
        own = [p.clone() for p in self.parameters] if self.averages else []
        _copy(self.parameters, self.averages)
        try:
            yield
        finally:
            _copy(self.parameters, own)


def _copy(targets: list[Tensor], sources: list[Tensor]) -> None:
    if sources:
        torch._foreach_copy_(targets, sources)
