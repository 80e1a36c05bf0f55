"""Prepare the machine for a run, and read a run back from its folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numba
import torch

from nerfreg.config.saved import read_run
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError
from nerfreg.field import RadianceField
from nerfreg.field.fit import fitted
from nerfreg.field.workers import set_threads, threads
from nerfreg.registry import Hooks
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


def load_run(
    run: Path, overrides: Sequence[str] = ()
) -> tuple[Config, Scene, RadianceField, State]:
    """Read a run back from its folder.

    Args:
        run: The run's folder.
        overrides: `key=value` changes of the saved configuration.

    Returns:
        Its configuration, its scene, its trained field, and where it stood at its end.

    Raises:
        NerfregError: There is no run, its plugins are not installed, or its weights do not fit.
    """
    # Must come before large tensors are allocated.
    keep_large_blocks()
    config = read_run(run, overrides)
    scene = load_scene(config.scene)
    config = replace(config, field=fitted(config.field, scene))
    # With the layers of the run's plugins: their parameters are part of the checkpoint.
    field = RadianceField(config.field, scene.box, Hooks(config.reg).layer)
    state = load_checkpoint(run, field)
    return config, scene, field.to(prepare(config)).eval(), state
