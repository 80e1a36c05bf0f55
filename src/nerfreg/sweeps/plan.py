"""What is known of a sweep before its first job: how many jobs, how many at once, and whether they can be used."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep, Override
from omegaconf import DictConfig, OmegaConf

from nerfreg.config.schema import Config
from nerfreg.config.validation import validated
from nerfreg.errors import NerfregError
from nerfreg.evaluation.lpips_weights import HOW_TO_GET_WEIGHTS, find_lpips_weights
from nerfreg.scenes import load_scene

OBJECTIVE = "average"
"""What a sweeper minimizes: one number of error, noise and perception, and minimizing is every sweeper's default."""


@dataclass(frozen=True)
class Plan:
    """jobs: how many. varied: the keys in which they differ, as `+reg`.

    at_once: how many of them on one machine; None: as many as the launcher's cluster decides.
    tuned: whether a sweeper chooses the next job by the results of those before.
    """

    jobs: int
    varied: tuple[str, ...]
    at_once: int | None
    tuned: bool

    @property
    def parallel(self) -> bool:
        """Whether jobs may run side by side, each in a process of its own."""
        return self.at_once != 1

    def title(self, overrides: Sequence[str]) -> str:
        """What distinguishes a job from the others; all its overrides if nothing does."""
        varied = [override for override in overrides if override.partition("=")[0] in self.varied]
        return " ".join(varied or overrides)


def make_plan(hydra_config: DictConfig) -> Plan:
    """The plan of a sweep. Raises NerfregError where no job could be used, and where test views would choose.

    Configurations are composed until one can be used; the others may still fail, each for itself.
    """
    hydra = hydra_config.hydra
    words = [
        f"{key}={value}" for key, value in (OmegaConf.select(hydra, "sweeper.params") or {}).items()
    ]
    overrides = _last_of_each_key(
        OverridesParser.create().parse_overrides([*words, *hydra.overrides.task])
    )
    for override in OverridesParser.create().parse_overrides([*hydra.overrides.hydra]):
        if override.key_or_group == "hydra.sweep.subdir":
            raise NerfregError(
                f"{override.input_line}: run folders of a sweep are named by their overrides, so that they are found "
                "again; choose hydra.sweep.dir=FOLDER or name=STUDY"
            )
    tuned = not str(hydra.sweeper._target_).endswith(".BasicSweeper")
    jobs = (
        hydra.sweeper.n_trials
        if "n_trials" in hydra.sweeper
        else math.prod(_count(word) for word in overrides)
    )
    config = _first_usable(hydra_config, overrides)
    if tuned:
        _check_objective(hydra_config, config)
    batch = min(int(jobs), hydra.sweeper.n_jobs) if "n_jobs" in hydra.sweeper else int(jobs)
    varied = tuple(
        override.get_key_element() for override in overrides if override.is_sweep_override()
    )
    return Plan(int(jobs), varied, _at_once(hydra.launcher, batch), tuned)


def _last_of_each_key(overrides: Sequence[Override]) -> list[Override]:
    return list({override.get_key_element(): override for override in overrides}.values())


def _count(override: Override) -> int:
    return len([*_choices(override)])


def _choices(override: Override) -> Iterator[str]:
    """The overrides that a sweep makes of one; of an interval its beginning."""
    if not override.is_sweep_override():
        assert override.input_line is not None
        yield override.input_line
    elif override.is_discrete_sweep():
        yield from (
            f"{override.get_key_element()}={value}" for value in override.sweep_string_iterator()
        )
    else:
        interval = override.value()
        assert isinstance(interval, IntervalSweep)
        yield f"{override.get_key_element()}={interval.start}"


def _first_usable(hydra_config: DictConfig, overrides: Sequence[Override]) -> Config:
    """The first configuration that is not refused; if all are, the first one's error."""
    loader = GlobalHydra.instance().config_loader()
    refused: NerfregError | None = None
    for job in itertools.product(*map(_choices, overrides)):
        node = loader.load_sweep_config(hydra_config, list(job))
        OmegaConf.set_struct(node, False)
        del node["hydra"]
        OmegaConf.set_struct(node, True)
        try:
            config = validated(node)
            load_scene(config.scene)  # finds what is missing, and reads no image
            return config
        except NerfregError as error:
            refused = refused or error
    assert refused is not None
    raise refused


def _check_objective(hydra_config: DictConfig, config: Config) -> None:
    choice = OmegaConf.select(hydra_config, "hydra.runtime.choices")["hydra/sweeper"]
    if config.scene.held_out is None:
        raise NerfregError(
            f"hydra/sweeper={choice} would choose by test views; set e.g. scene.held_out=[0]"
        )
    direction = OmegaConf.select(hydra_config, "hydra.sweeper.direction", default="minimize")
    direction = getattr(direction, "name", direction)
    if direction != "minimize":
        raise NerfregError(
            f"hydra.sweeper.direction={direction}: the objective is the error '{OBJECTIVE}'; minimize it"
        )
    if not config.eval.lpips:
        raise NerfregError(
            f"eval.lpips=false: '{OBJECTIVE}', which hydra/sweeper={choice} minimizes, needs LPIPS"
        )
    if find_lpips_weights(config.eval.lpips_weights) is None:
        raise NerfregError(f"hydra/sweeper={choice} minimizes '{OBJECTIVE}': {HOW_TO_GET_WEIGHTS}")


def _at_once(launcher: DictConfig, batch: int) -> int | None:
    """How many jobs of those that are launched together run at the same time on this machine."""
    kind = str(launcher._target_).rpartition(".")[2]
    if kind == "BasicLauncher":
        return 1
    if kind == "JoblibLauncher":
        workers = int(launcher.n_jobs or 1)
        return max(1, workers if workers > 0 else (os.cpu_count() or 1) + 1 + workers)
    if kind == "LocalLauncher":
        return batch
    return None
