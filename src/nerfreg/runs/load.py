"""Prepare the machine for a run, and read a run back from its folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numba
import torch

from nerfreg.config.saved import read_run
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError
from nerfreg.evaluation.trained import TrainedField
from nerfreg.field.fit import fitted
from nerfreg.field.workers import set_threads, threads
from nerfreg.hooks import Step
from nerfreg.registry import Hooks
from nerfreg.registry.field import make_field
from nerfreg.rendering.renderer import Renderer
from nerfreg.scenes import Scene, load_scene
from nerfreg.training.checkpoint import State, load_checkpoint
from nerfreg.training.memory import keep_large_blocks


def prepare(config: Config) -> torch.device:
    """Set the number of threads, and return the device of a run.

    Raises:
        NerfregError: The device is not available, or this machine has fewer threads.
    """
    count = threads() if config.train.threads is None else config.train.threads
    if not 1 <= count <= numba.config.NUMBA_NUM_THREADS:
        most = numba.config.NUMBA_NUM_THREADS
        raise NerfregError(f"train.threads={count}: must be between 1 and {most} on this machine")
    set_threads(count)
    name = config.device
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
        # A well-formed name may belong to a device that is not there, which only its use shows.
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise NerfregError(f"device={name}: not available here ({reason})") from error
    return device


@dataclass(frozen=True)
class LoadedRun:
    """A run that has been read back.

    Attributes:
        config: Its configuration.
        state: Where it stood when its checkpoint was saved.
        trained: Its field, in evaluation.
    """

    config: Config
    state: State
    trained: TrainedField

    @property
    def scene(self) -> Scene:
        """Its scene."""
        return self.trained.scene


def load_run(run: Path, overrides: Sequence[str] = ()) -> LoadedRun:
    """Read a run back from its folder.

    Args:
        run: The run's folder.
        overrides: `key=value` changes of the saved configuration.

    Raises:
        NerfregError: There is no run, its plugins are not installed, or its weights do not fit.
    """
    # Must come before large tensors are allocated.
    keep_large_blocks()
    config = read_run(run, overrides)
    scene = load_scene(config.scene)
    config = replace(config, field=fitted(config.field, scene))
    device = prepare(config)
    return LoadedRun(config, *load_trained(run, config, scene, Hooks(config.reg), device))


def load_trained(
    run: Path, config: Config, scene: Scene, hooks: Hooks, device: torch.device
) -> tuple[State, TrainedField]:
    """Read the checkpoint of a run, with the state of its plugins.

    Args:
        run: The run's folder.
        config: Its configuration, with the field fitted to the scene.
        scene: Its scene.
        hooks: Hooks of its plugins, which have taken part in nothing yet.
        device: Where the field is to be.

    Raises:
        NerfregError: The checkpoint is missing or damaged, or does not fit the configuration.
    """
    # With what the run's plugins put into it: their parameters are part of the checkpoint.
    field = make_field(config.field, scene.info, hooks)
    state = load_checkpoint(run, field)
    hooks.load_state_dict(state.plugins)
    step = Step(
        index=state.step,
        total=state.step,
        fraction=state.fraction,
        generator=torch.Generator().manual_seed(0),
        bounds=(scene.near, scene.far),
        renderer=Renderer(field.to(device).eval(), config.sampler, hooks),
        training=False,
        scene=scene.info,
    )
    hooks.begin(step)
    return state, TrainedField(field, hooks, step, config.sampler, scene)
