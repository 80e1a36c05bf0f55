"""Trainers of any configuration, at any share of their budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from nerfreg.config.compose import compose as compose_config
from nerfreg.config.compose import require_steps
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError
from nerfreg.registry import Hooks, Term
from nerfreg.runs.load import prepare
from nerfreg.scenes.scene import Scene
from nerfreg.training.trainer import Trainer

TINY = (
    "train.rays=64", "sampler.coarse=8", "sampler.fine=8", "field.levels=4", "field.finest=32", "field.log2_entries=10",
)  # fmt: skip
"""Overrides of a quick bench; what the command line says stands behind them, and wins."""


def compose(overrides: Sequence[str]) -> Config:
    """Return the configuration that `nerfreg train` would run, if a bench can measure it.

    Raises:
        NerfregError: The overrides cannot be composed, or leave the number of steps open.
    """
    config = compose_config(overrides)
    require_steps(config)
    return config


def prepare_cpu(config: Config) -> None:
    """Set the number of threads. Raises NerfregError where the configuration means another device."""
    device = prepare(config)
    if device.type != "cpu":
        raise NerfregError(
            f"device={config.device}: nerfreg bench measures the CPU; set device=cpu"
        )


def make_trainer(config: Config, scene: Scene, hooks: Hooks | None = None) -> Trainer:
    """The trainer of a run whose budget is counted in steps alone. hooks: those of the selected plugins if None."""
    return Trainer(
        scene,
        Hooks(config.reg) if hooks is None else hooks,
        config.field,
        config.sampler,
        config.optim,
        replace(config.train, seconds=None),
        config.seed,
    )


def step_at(trainer: Trainer, fraction: float) -> list[Term]:
    """One training step, taken where this share of the budget is spent."""
    assert trainer.budget.config.steps is not None
    trainer.budget.step = round(fraction * trainer.budget.config.steps)
    return trainer.step()
