"""Compose a configuration with Hydra and run a job on it, once or as a sweep."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import hydra
import numba
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from nerfreg.config.explain import COMPOSITION_ERRORS, Refused, check_overrides, explain
from nerfreg.config.folders import own_folder
from nerfreg.config.schema import Config, register
from nerfreg.config.validation import validated
from nerfreg.errors import NerfregError
from nerfreg.registry import PluginInfo
from nerfreg.sweeps import folders
from nerfreg.sweeps.failures import in_one_line
from nerfreg.sweeps.hook import before_sweep
from nerfreg.sweeps.jobs import Sweep
from nerfreg.sweeps.journal import JobState, Journal
from nerfreg.sweeps.plan import make_plan
from nerfreg.sweeps.summary import print_summary

Job = Callable[[Config, Path], object]


class SweepError(NerfregError):
    """A sweep ended for another reason than its jobs."""

    exit_code = 1


def launch(words: Sequence[str], job: Job, leaves: str | None = None) -> int:
    """Run a job, once or as a sweep, as Hydra's command line says.

    Options such as --cfg show something and run no job.

    Args:
        words: The command line after the verb.
        job: Called with the configuration and the folder of each run.
        leaves: The file that a complete job leaves in its folder, so that a sweep need not do it
            again.

    Returns:
        The exit code: 1 if a job of a sweep failed, else 0.

    Raises:
        NerfregError: Something cannot be composed, or a folder cannot be written.
    """
    check_overrides(words)
    task = _Task(job, leaves)
    _warn_of_broken(task.plugins)
    # Hydra would print its own version of every error and exit; with this it raises.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    sys.argv = ["nerfreg", *words]
    run = hydra.main(version_base="1.3", config_path=str(own_folder()), config_name="config")(task)
    try:
        with before_sweep(task.prepare):
            run()
    except Refused as refused:
        raise refused.error from refused.error.__cause__
    except COMPOSITION_ERRORS as error:
        raise NerfregError(explain(error, task.plugins, words)) from error
    except BrokenPipeError:
        raise
    except OSError as error:
        raise NerfregError(
            f"cannot use {error.filename}: {error.strerror}" if error.filename else str(error)
        ) from error
    except Exception as error:
        if task.sweep is None:
            raise
        raise SweepError(f"the sweep stopped: {in_one_line(error)}") from error
    finally:
        failed = task.conclude()
    return int(failed)


class _Task:
    """What Hydra calls for every job.

    Launchers send it to other processes, where unpickling it makes Hydra ready.
    """

    def __init__(self, job: Job, leaves: str | None) -> None:
        self._job = job
        self._leaves = leaves
        self.sweep: Sweep | None = None
        self.plugins = _register()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "plugins"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.plugins = _register()

    def prepare(self, hydra_config: DictConfig) -> None:
        """Before the first job of a sweep: refuse what no job could use."""
        try:
            plan = make_plan(hydra_config)
        except NerfregError as error:
            raise Refused(error) from error
        except COMPOSITION_ERRORS as error:
            raise Refused(
                NerfregError(explain(error, self.plugins, hydra_config.hydra.overrides.task))
            ) from error
        if plan.at_once not in (None, 1):
            # joblib would limit numba to a job's share of the cores, whatever train.threads says.
            os.environ.setdefault("NUMBA_NUM_THREADS", str(numba.config.NUMBA_NUM_THREADS))
        name = f"{datetime.now():%Y-%m-%d_%H-%M-%S}_{os.getpid()}"
        journal = Journal(Path(hydra_config.hydra.sweep.dir).absolute() / ".jobs" / name)
        self.sweep = Sweep(plan, journal, self._leaves)

    def __call__(self, node: DictConfig) -> float | None:
        hydra_config = HydraConfig.get()
        folder = Path(hydra_config.runtime.output_dir)
        if hydra_config.mode is RunMode.MULTIRUN and self.sweep is not None:
            overrides = [*hydra_config.overrides.task]
            compose = lambda: self._validated(node)  # noqa: E731
            return self.sweep.attempt(hydra_config.job.num, overrides, folder, compose, self._job)
        try:
            self._job(self._validated(node), folder)
        except NerfregError as error:
            _discard(folder)
            raise Refused(error) from error
        return None

    def conclude(self) -> bool:
        """Print what became of a sweep, if it was one; returns whether a job of it failed."""
        if self.sweep is None:
            return False
        entries = self.sweep.journal.read()
        print_summary(entries, self.sweep.plan.jobs)
        self.sweep.journal.remove()
        return any(entry.state is JobState.FAILED for entry in entries)

    def _validated(self, node: DictConfig) -> Config:
        try:
            return validated(node)
        except COMPOSITION_ERRORS as error:
            raise NerfregError(explain(error, self.plugins)) from error


def _register() -> list[PluginInfo]:
    folders.register()
    return register()


def _discard(folder: Path) -> None:
    """Remove what Hydra wrote for a run that was refused before it began."""
    if sorted(path.name for path in folder.iterdir()) == [".hydra"]:
        shutil.rmtree(folder)
        for parent in list(folder.parents)[:2]:
            if parent == Path.cwd() or any(parent.iterdir()):
                break
            parent.rmdir()


def _warn_of_broken(plugins: Sequence[PluginInfo]) -> None:
    for plugin in plugins:
        if plugin.error:
            who = f"plugin '{plugin.name}' of package {plugin.package}"
            print(f"nerfreg: warning: {who} is left out: {plugin.error}", file=sys.stderr)
        elif plugin.clash:
            print(f"nerfreg: warning: package {plugin.package}: {plugin.clash}", file=sys.stderr)


def train(config: Config, folder: Path) -> None:
    """Train, as the job of `nerfreg train`."""
    # A sweep's own process needs no torch.
    from nerfreg.runs.train import train

    train(config, folder)


def show_scene(config: Config, folder: Path) -> None:
    """Describe a scene and draw its cameras, as the job of `nerfreg scene`."""
    from nerfreg.scenes import load_scene
    from nerfreg.scenes.inspect import describe, draw_cameras

    scene = load_scene(config.scene)
    print(describe(scene))
    picture = folder / "cameras.png"
    draw_cameras(scene, picture)
    print(picture)
