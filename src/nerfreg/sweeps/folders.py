"""One folder for each configuration of a sweep, found again when the sweep is started again."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from yaml import YAMLError

from nerfreg.config.naming import digest, overrides_name, study_name
from nerfreg.errors import NerfregError
from nerfreg.runs.files import FAILED, METRICS, RECORDED_STEPS, RENDERS
from nerfreg.training.checkpoint import FOLDER as CHECKPOINT

LEFT_OVER = (FAILED, METRICS, CHECKPOINT, RECORDED_STEPS, RENDERS)
WITHOUT_EFFECT = (("name",), ("train", "quiet"))
"""Keys in which configurations may differ and yet be the same."""


class BusyError(NerfregError):
    """Another process works in this folder."""


def register() -> None:
    """Tell OmegaConf how the folders of a sweep are called."""
    OmegaConf.register_new_resolver("job_folder", job_folder, replace=True)


def job_folder(*, _root_: DictConfig) -> str:
    """STUDY/OVERRIDES, below `hydra.sweep.dir`.

    Where that folder already belongs to another configuration (a YAML file or a default was changed since), it is
    STUDY/OVERRIDES_HASH: Hydra writes `.hydra/config.yaml` before the job begins, so that only here a folder can be
    kept from being given to a second configuration.
    """
    study = study_name(_root_)
    overrides = overrides_name(OmegaConf.select(_root_, "hydra.overrides.task")) or "defaults"
    wanted = configuration(_root_)
    saved = (
        Path(str(OmegaConf.select(_root_, "hydra.sweep.dir")))
        / study
        / overrides
        / ".hydra"
        / "config.yaml"
    )
    if saved.is_file() and _saved_configuration(saved) != wanted:
        overrides = f"{overrides}_{digest(repr(wanted))}"
    return f"{study}/{overrides}"


def configuration(root: DictConfig) -> Any:
    """What a run depends on, interpolations as they are written."""
    keys = [str(key) for key in root if key != "hydra"]
    # by way of YAML, so that types that a file does not keep make no difference
    return _comparable(OmegaConf.to_yaml(OmegaConf.masked_copy(root, keys)))


def _saved_configuration(path: Path) -> Any:
    try:
        return _comparable(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, YAMLError):
        return None


def _comparable(text: str) -> Any:
    node = OmegaConf.create(text)
    values = OmegaConf.to_container(node)
    for *parents, key in WITHOUT_EFFECT:
        parent = values
        for name in parents:
            parent = parent.get(name) if isinstance(parent, dict) else None
        if isinstance(parent, dict):
            parent.pop(key, None)
    return values


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Keep other processes on this file system from working in a run's folder. Raises BusyError where one does."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BusyError(f"{folder}: another process is at it") from error
        except OSError:
            pass  # a file system without locks
        yield
    finally:
        os.close(handle)


def clear(folder: Path) -> None:
    """Remove what a run that did not come to its end has left."""
    for name in LEFT_OVER:
        path = folder / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
