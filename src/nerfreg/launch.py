"""Compose a configuration with Hydra and run a job on it, once or as a sweep."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from nerfreg.config import Config, own_folder, register, validated
from nerfreg.errors import NerfregError
from nerfreg.explain import COMPOSITION_ERRORS, check_overrides, explain
from nerfreg.registry import PluginInfo

Job = Callable[[Config, Path], None]


def launch(words: Sequence[str], job: Job) -> None:
    """Run `job(config, folder)` as Hydra's command line `words` say; without a job for --cfg, --help and the like.

    Raises NerfregError in one line for whatever cannot be composed, and for folders that cannot be written.
    """
    check_overrides(words)
    plugins = register()
    _warn_of_broken(plugins)
    # Hydra would print its own version of every error and exit; with this it raises.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    sys.argv = ["nerfreg", *words]
    run = hydra.main(version_base="1.3", config_path=str(own_folder()), config_name="config")(_task(job, plugins))
    try:
        run()
    except _Refused as refused:
        raise refused.error from refused.error.__cause__
    except COMPOSITION_ERRORS as error:
        raise NerfregError(explain(error, plugins, words)) from error
    except BrokenPipeError:
        raise
    except OSError as error:
        raise NerfregError(
            f"cannot use {error.filename}: {error.strerror}" if error.filename else str(error)
        ) from error


def _task(job: Job, plugins: Sequence[PluginInfo]) -> Callable[[DictConfig], None]:
    def task(node: DictConfig) -> None:
        folder = Path(HydraConfig.get().runtime.output_dir)
        try:
            try:
                config = validated(node)
            except COMPOSITION_ERRORS as error:
                raise NerfregError(explain(error, plugins)) from error
            job(config, folder)
        except NerfregError as error:
            _discard(folder)
            raise _Refused(error) from error

    return task


class _Refused(BaseException):
    """Carries a NerfregError past Hydra, which prints a line of its own about every Exception of a job."""

    def __init__(self, error: NerfregError) -> None:
        self.error = error


def _discard(folder: Path) -> None:
    """Remove what Hydra wrote for a run that never began."""
    if sorted(path.name for path in folder.iterdir()) == [".hydra"]:
        shutil.rmtree(folder)
        for parent in list(folder.parents)[:2]:
            if parent == Path.cwd() or any(parent.iterdir()):
                break
            parent.rmdir()


def _warn_of_broken(plugins: Sequence[PluginInfo]) -> None:
    for plugin in plugins:
        if plugin.error:
            line = f"nerfreg: warning: plugin '{plugin.name}' of package {plugin.package} is left out: {plugin.error}"
            print(line, file=sys.stderr)


def train(config: Config, folder: Path) -> None:
    from nerfreg.runs import train

    train(config, folder)


def show_scene(config: Config, folder: Path) -> None:
    from nerfreg.scenes import load_scene
    from nerfreg.scenes.inspect import describe, draw_cameras

    scene = load_scene(config.scene)
    print(describe(scene))
    picture = folder / "cameras.png"
    draw_cameras(scene, picture)
    print(picture)
