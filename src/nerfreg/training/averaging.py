"""Exponential moving average of the weights."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager

import torch
from torch import nn


class MovingAverage:
    """Exponential moving average of a module's parameters.

    average <- d * average + (1 - d) * weights, where d is `decay`, or (1 + n) / (10 + n) at the
    n-th update as long as that is smaller.

    Attributes:
        decay: Upper bound of d, in [0, 1). 0 keeps no copy: the average is the weights.
        parameters: The parameters that are averaged.
        averages: Their averages; empty if `decay` is 0.
        updates: Number n of updates so far.
    """

    def __init__(
        self, module: nn.Module, decay: float, left_out: Collection[nn.Parameter] = ()
    ) -> None:
        """Begin with the present weights.

        Args:
            module: The module.
            decay: Upper bound of d.
            left_out: Parameters of the module that are not averaged.
        """
        excluded = {id(parameter) for parameter in left_out}
        self.decay = decay
        self.parameters = [p for p in module.parameters() if id(p) not in excluded]
        self.averages = [p.detach().clone() for p in self.parameters] if decay else []
        self.updates = 0

    @torch.no_grad()
    def update(self) -> None:
        """Take the present weights into the average."""
        if self.averages:
            self.updates += 1
            # A short memory at first, so that the random initial weights are soon forgotten.
            decay = min(self.decay, (1 + self.updates) / (10 + self.updates))
            # One pass over all parameters, because memory bandwidth is what limits the average.
            torch._foreach_lerp_(self.averages, [p.detach() for p in self.parameters], 1 - decay)

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Give the module the averaged weights within this context, and its own again after it.

        Nothing is copied, and a graph that was recorded before can be differentiated afterwards.
        """
        # The optimizer and the field hold references to the parameters, which stay the same
        # objects; only where their values lie is exchanged.
        own = [p.data for p in self.parameters]
        try:
            for parameter, average in zip(self.parameters, self.averages, strict=False):
                parameter.data = average
            yield
        finally:
            for parameter, values in zip(self.parameters, own, strict=True):
                parameter.data = values
