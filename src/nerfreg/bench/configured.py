"""Trainers of any configuration, at any share of their budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import hydra
from hydra import initialize_config_dir

from nerfreg.config.explain import COMPOSITION_ERRORS, check_overrides, explain
from nerfreg.config.schema import Config, own_folder, register, validated
from nerfreg.errors import NerfregError
from nerfreg.registry import Hooks, Term
from nerfreg.runs.train import prepare
from nerfreg.scenes.scene import Scene
from nerfreg.training.trainer import Trainer

TINY = (
    "train.rays=64", "sampler.coarse=8", "sampler.fine=8", "field.levels=4", "field.finest=32", "field.log2_entries=10",
)  # fmt: skip
"""Overrides of a quick bench; what the command line says stands behind them, and wins."""


def compose(overrides: Sequence[str]) -> Config:
    """The configuration that `nerfreg train` would run; no run folder is made.

    Raises NerfregError in one line for whatever cannot be composed, and for what a bench cannot measure.
    """
    check_overrides(overrides)
    plugins = register()
    try:
        with initialize_config_dir(str(own_folder()), version_base="1.3"):
            config = validated(hydra.compose("config", overrides=[*overrides]))
    except COMPOSITION_ERRORS as error:
        raise NerfregError(explain(error, plugins, overrides)) from error
    if config.train.steps is None:
        raise NerfregError(
            "train.steps=null: set it; seconds alone do not say which step stands where in the budget"
        )
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
