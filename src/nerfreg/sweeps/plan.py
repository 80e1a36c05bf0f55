"""What is known of a sweep before its first job: how many jobs there are, and what they vary."""

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
"""What a sweeper minimizes: one number for error, structure and perception. It is an error and not
a PSNR because to minimize is the default of every sweeper."""


@dataclass(frozen=True)
class Plan:
    """What is known of a sweep before its first job.

    Attributes:
        jobs: How many there are.
        varied: The keys in which they differ, as `+reg`.
        at_once: How many run at the same time on one machine; None: the launcher's cluster decides.
        tuned: Whether a sweeper chooses each job by the results of those before.
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
        """Return what distinguishes a job from the others; all its overrides if nothing does."""
        varied = [override for override in overrides if override.partition("=")[0] in self.varied]
        return " ".join(varied or overrides)


def make_plan(hydra_config: DictConfig) -> Plan:
    """Plan a sweep.

    Configurations are composed until one is usable; the others may still fail, each alone.

    Args:
        hydra_config: The whole configuration, `hydra` included.

    Raises:
        NerfregError: No job could be used, or test views would choose.
    """
    hydra = hydra_config.hydra
    params = OmegaConf.select(hydra, "sweeper.params") or {}
    words = [f"{key}={value}" for key, value in params.items()]
    overrides = _last_of_each_key(
        OverridesParser.create().parse_overrides([*words, *hydra.overrides.task])
    )
    for override in OverridesParser.create().parse_overrides([*hydra.overrides.hydra]):
        if override.key_or_group == "hydra.sweep.subdir":
            raise NerfregError(
                f"{override.input_line}: run folders of a sweep are named by their overrides, so "
                "that they are found again; choose hydra.sweep.dir=FOLDER or name=STUDY"
            )
    tuned = not str(hydra.sweeper._target_).endswith(".BasicSweeper")
    if "n_trials" in hydra.sweeper:
        jobs = int(hydra.sweeper.n_trials)
    else:
        jobs = math.prod(len([*_choices(override)]) for override in overrides)
    config = _first_usable(hydra_config, overrides)
    if tuned:
        _check_objective(hydra_config, config)
    batch = min(jobs, hydra.sweeper.n_jobs) if "n_jobs" in hydra.sweeper else jobs
    varied = tuple(
        override.get_key_element() for override in overrides if override.is_sweep_override()
    )
    return Plan(jobs, varied, _at_once(hydra.launcher, batch), tuned)


def _last_of_each_key(overrides: Sequence[Override]) -> list[Override]:
    return list({override.get_key_element(): override for override in overrides}.values())


def _choices(override: Override) -> Iterator[str]:
    """Yield the overrides that a sweep makes of one; of an interval only its beginning."""
    if not override.is_sweep_override():
        assert override.input_line is not None
        yield override.input_line
    elif override.is_discrete_sweep():
        key = override.get_key_element()
        yield from (f"{key}={value}" for value in override.sweep_string_iterator())
    else:
        interval = override.value()
        assert isinstance(interval, IntervalSweep)
        yield f"{override.get_key_element()}={interval.start}"


def _first_usable(hydra_config: DictConfig, overrides: Sequence[Override]) -> Config:
    """Return the first configuration that is not refused, or raise what refused the first."""
    loader = GlobalHydra.instance().config_loader()
    refused: NerfregError | None = None
    for job in itertools.product(*map(_choices, overrides)):
        node = loader.load_sweep_config(hydra_config, list(job))
        # A struct, as Hydra returns it, refuses to lose a key.
        OmegaConf.set_struct(node, False)
        del node["hydra"]
        OmegaConf.set_struct(node, True)
        try:
            config = validated(node)
            load_scene(config.scene)  # Finds out what is missing, and reads no image.
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
    direction = getattr(direction, "name", direction)  # An enum of Optuna's sweeper, or a word.
    if direction != "minimize":
        raise NerfregError(
            f"hydra.sweeper.direction={direction}: the objective is the error '{OBJECTIVE}'; "
            "minimize it"
        )
    if not config.eval.lpips:
        raise NerfregError(
            f"eval.lpips=false: '{OBJECTIVE}', which hydra/sweeper={choice} minimizes, needs LPIPS"
        )
    if find_lpips_weights(config.eval.lpips_weights) is None:
        raise NerfregError(f"hydra/sweeper={choice} minimizes '{OBJECTIVE}': {HOW_TO_GET_WEIGHTS}")


def _at_once(launcher: DictConfig, batch: int) -> int | None:
    """Return how many of the jobs that are launched together run at once on this machine."""
    kind = str(launcher._target_).rpartition(".")[2]
    if kind == "BasicLauncher":
        return 1
    if kind == "JoblibLauncher":
        # As joblib counts: -1 is all cores, -2 all but one, and so on.
        workers = int(launcher.n_jobs or 1)
        return max(1, workers if workers > 0 else (os.cpu_count() or 1) + 1 + workers)
    if kind == "LocalLauncher":
        return batch
    return None
