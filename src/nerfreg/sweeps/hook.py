"""Lets a sweep be checked before its first job."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

from hydra.experimental.callback import Callback
from omegaconf import DictConfig


class BeforeSweep(Callback):
    """The callback that `conf/config.yaml` names.

    Attributes:
        listeners: What to call. It belongs to the class because Hydra makes the instance itself.
    """

    listeners: ClassVar[list[Callable[[DictConfig], None]]] = []

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Call the listeners; Hydra's signature."""
        for listener in self.listeners:
            listener(config)


@contextmanager
def before_sweep(prepare: Callable[[DictConfig], None]) -> Iterator[None]:
    """Call `prepare(hydra_config)` when a sweep begins inside the block.

    Hydra swallows any `Exception` that `prepare` raises.
    """
    BeforeSweep.listeners.append(prepare)
    try:
        yield
    finally:
        BeforeSweep.listeners.remove(prepare)
