"""Where Hydra lets a sweep be looked at before its first job."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

from hydra.experimental.callback import Callback
from omegaconf import DictConfig


class BeforeSweep(Callback):
    """Named in `conf/config.yaml`; Hydra makes one itself, so that what is to be called stands in the class."""

    listeners: ClassVar[list[Callable[[DictConfig], None]]] = []

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        for listener in self.listeners:
            listener(config)


@contextmanager
def before_sweep(prepare: Callable[[DictConfig], None]) -> Iterator[None]:
    """Call `prepare(hydra_config)` when a sweep begins; whatever Exception it raises is lost on Hydra."""
    BeforeSweep.listeners.append(prepare)
    try:
        yield
    finally:
        BeforeSweep.listeners.remove(prepare)
