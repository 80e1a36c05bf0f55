"""Compose a configuration inside a program, as `nerfreg train` does on its command line."""

from __future__ import annotations

from collections.abc import Sequence

import hydra
from hydra import initialize_config_dir

from nerfreg.config.explain import COMPOSITION_ERRORS, check_overrides, explain
from nerfreg.config.folders import own_folder
from nerfreg.config.schema import Config, register
from nerfreg.config.validation import validated
from nerfreg.errors import NerfregError


def compose(overrides: Sequence[str]) -> Config:
    """Return the configuration that `nerfreg train` would run; no run folder is made.

    Raises:
        NerfregError: The overrides cannot be composed, in one line that says why.
    """
    check_overrides(overrides)
    plugins = register()
    try:
        with initialize_config_dir(str(own_folder()), version_base="1.3"):
            return validated(hydra.compose("config", overrides=[*overrides]))
    except COMPOSITION_ERRORS as error:
        raise NerfregError(explain(error, plugins, overrides)) from error


def require_steps(config: Config) -> None:
    """Refuse a budget in seconds alone, for tools that compare steps.

    Raises:
        NerfregError: `train.steps` is null.
    """
    if config.train.steps is None:
        raise NerfregError(
            "train.steps=null: set it; with seconds alone a step has no fixed place in the budget"
        )
