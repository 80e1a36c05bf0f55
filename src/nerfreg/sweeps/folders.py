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
"""What a run that did not end may have left in its folder."""

WITHOUT_EFFECT = (("name",), ("train", "quiet"))
"""Keys that change nothing in a run: configurations that differ in them alone are the same."""


class BusyError(NerfregError):
    """Another process works in this folder."""


def register() -> None:
    """Make `job_folder` known to OmegaConf, which `conf/config.yaml` uses for `hydra.sweep`."""
    OmegaConf.register_new_resolver("job_folder", job_folder, replace=True)


def job_folder(*, _root_: DictConfig) -> str:
    """Return the folder of a job below `hydra.sweep.dir`, as STUDY/OVERRIDES.

    Where that folder already belongs to another configuration, because a YAML file or a default
    was changed since, the result is STUDY/OVERRIDES_HASH. This must happen in a resolver: Hydra
    writes `.hydra/config.yaml` before the job begins, and would overwrite that of the other.

    Args:
        _root_: The whole configuration, `hydra` included; OmegaConf passes it by this name.
    """
    study = study_name(_root_)
    overrides = overrides_name(OmegaConf.select(_root_, "hydra.overrides.task")) or "defaults"
    wanted = configuration(_root_)
    folder = Path(str(OmegaConf.select(_root_, "hydra.sweep.dir")), study, overrides)
    saved = folder / ".hydra" / "config.yaml"
    if saved.is_file() and _saved_configuration(saved) != wanted:
        overrides = f"{overrides}_{digest(repr(wanted))}"
    return f"{study}/{overrides}"


def configuration(root: DictConfig) -> Any:
    """Return what a run depends on as plain containers, interpolations as they are written."""
    keys = [str(key) for key in root if key != "hydra"]
    # The way through YAML makes this comparable with a file, which does not keep all types.
    return _comparable(OmegaConf.to_yaml(OmegaConf.masked_copy(root, keys)))


def _saved_configuration(path: Path) -> Any:
    try:
        return _comparable(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, YAMLError):
        return None


def _comparable(text: str) -> Any:
    values = OmegaConf.to_container(OmegaConf.create(text))
    for *parents, key in WITHOUT_EFFECT:
        parent = values
        for name in parents:
            parent = parent.get(name) if isinstance(parent, dict) else None
        if isinstance(parent, dict):
            parent.pop(key, None)
    return values


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Keep other processes, on this file system, out of the folder of a run.

    Raises:
        BusyError: Another process works in it.
    """
    # The lock belongs to the open handle, so it ends with the process, however that ends.
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BusyError(f"{folder}: another process is at it") from error
        except OSError:
            pass  # This file system has no locks.
        yield
    finally:
        os.close(handle)


def clear(folder: Path) -> None:
    """Remove what a run that did not end has left."""
    for name in LEFT_OVER:
        path = folder / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
