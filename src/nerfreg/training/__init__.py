"""The training loop, its budget and what it saves."""

from nerfreg.training.config import OptimConfig, TrainConfig

__all__ = ["OptimConfig", "TrainConfig"]
