"""How much of a run is done, in steps or in seconds."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from numba.core import event

from nerfreg.errors import NerfregError
from nerfreg.training.config import TrainConfig


class Budget:
    """Steps and seconds that a run has spent; it ends when either limit is reached.

    Only time within `spend` and `prepare` counts, so that evaluation is free. The compilation of
    kernels does not count there either, including kernels of plugins.

    Attributes:
        config: The limits.
        step: Number of steps done.
        seconds: Training time so far, in seconds.

    Raises:
        NerfregError: The budget has no limit, or a limit is not positive.
    """

    def __init__(self, config: TrainConfig) -> None:
        if config.steps is None and config.seconds is None:
            raise NerfregError(
                "train.steps and train.seconds are both null: set at least one of them, "
                "or the run would never end"
            )
        for key in ("steps", "seconds", "rays"):
            value = getattr(config, key)
            if value is not None and value <= 0:
                raise NerfregError(f"train.{key}={value}: must be positive")
        self.config = config
        self.step = 0
        self.seconds = 0.0
        self._prepared = 0.0

    @property
    def fraction(self) -> float:
        """Share of the budget that is spent, 0 to 1."""
        by_steps = self.step / self.config.steps if self.config.steps is not None else 0.0
        by_time = self.seconds / self.config.seconds if self.config.seconds is not None else 0.0
        return min(max(by_steps, by_time), 1.0)

    @property
    def total(self) -> int:
        """Number of steps that the run will have, an estimate while seconds limit it."""
        limit = self.config.steps
        # Before the first step there is no rate from which to project.
        if self.config.seconds is None or self.step == 0:
            return limit if limit is not None else 1
        # Preparation is spent once, and tells nothing of how long a step takes.
        left, stepping = self.config.seconds - self._prepared, self.seconds - self._prepared
        projected = max(self.step, round(self.step * left / max(stepping, 1e-9)))
        return projected if limit is None else min(limit, projected)

    @contextmanager
    def spend(self) -> Iterator[None]:
        """Count one step, and the time that passes in this context."""
        with self._timed():
            yield
        self.step += 1

    @contextmanager
    def prepare(self) -> Iterator[None]:
        """Count the time that passes in this context, but no step."""
        before = self.seconds
        with self._timed():
            yield
        self._prepared += self.seconds - before

    @contextmanager
    def _timed(self) -> Iterator[None]:
        start = time.perf_counter()
        # Kernels are compiled at their first call, wherever that happens: `Trainer.warm_up` calls
        # the core's, but nothing knows the kernels of plugins. Without this, a run with an empty
        # cache would make fewer steps in the same number of seconds.
        with event.install_listener("numba:compile", event.TimingListener()) as compilation:
            yield
        self.seconds += time.perf_counter() - start
        # The listener has no duration if nothing was compiled.
        if compilation.done:
            self.seconds -= compilation.duration
