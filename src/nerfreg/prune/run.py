"""`nerfreg prune`: one study from beginning to end."""

from __future__ import annotations

import hashlib
import json
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from omegaconf import OmegaConf
from rich.console import Console

from nerfreg import __version__
from nerfreg.config.compose import compose, require_steps
from nerfreg.config.saved import as_yaml
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError
from nerfreg.files import write_json
from nerfreg.prune.ledger import Ledger
from nerfreg.prune.plan import Design, make_folds, make_ladder
from nerfreg.prune.preset import plain, preset_path, write_preset
from nerfreg.prune.report import conclusions, print_report, record
from nerfreg.prune.study import Study
from nerfreg.prune.trials import Trials
from nerfreg.registry.plugins import is_used


@dataclass(frozen=True)
class PruneOptions:
    """What the command line says.

    Attributes:
        overrides: Those of `nerfreg train`.
        budget: Seconds of all trainings together.
        folds: Of the training views; None: up to four.
        steps: Of the first trainings; None: a quarter of `train.steps`.
        tolerance: dB of PSNR that count as no difference.
        stride: Every how many rows and columns are scored.
        name: Of the preset; None: after the scene.
        folder: Where the files go; None: after the scene.
    """

    overrides: tuple[str, ...] = ()
    budget: float = 3600.0
    folds: int | None = None
    steps: int | None = None
    tolerance: float = 0.1
    stride: int = 2
    name: str | None = None
    folder: Path | None = None


def run(options: PruneOptions, command: Sequence[str]) -> None:
    """Run a study, print what it found, and leave its files and the preset.

    Args:
        options: Of the study.
        command: The command line, which is recorded and repeats the study.

    Raises:
        NerfregError: The options cannot be used.
    """
    config = _configuration(options.overrides)
    trials = Trials(config, options.stride)
    scene = trials.scene
    path = preset_path(options.name or f"pruned_{plain(scene.name)}")
    folder = options.folder or Path("prune", plain(scene.name))
    cells = folder / "cells.jsonl"
    design = Design(
        tuple(str(name) for name, plugin in config.reg.items() if is_used(plugin)),
        make_folds(len(scene.train) + len(scene.test), options.folds),
        make_ladder(options.steps, config.train.steps),
        config.seed,
    )
    ledger = Ledger(trials, cells, fingerprint(config, options.stride))
    console = Console(stderr=True, quiet=config.train.quiet)
    lines = partial(console.print, highlight=False, markup=False, soft_wrap=True)
    with console.status("", refresh_per_second=2) as status:
        # A terminal has one line, which changes; a file has one for each trial.
        say = status.update if console.is_terminal else lines
        study = Study(design, ledger, options.budget, options.tolerance, say)
        try:
            study.run()
        except KeyboardInterrupt:
            kept = f"{cells} keeps what is measured; the same command goes on from there"
            print(kept, file=sys.stderr)
            raise
    if ledger.reused:
        print(f"{ledger.reused} of {len(ledger.trials)} trainings were found in {cells}")
    print_report(study, scene.name, Console())
    of = f"of {'+'.join(design.full)} on {scene.name} with {design.views} views."
    layout_known = replace(config, scene=replace(config.scene, layout=scene.layout))
    write_preset(path, layout_known, study.pruned, [of, shlex.join(command), *conclusions(study)])
    head = {"command": [*command], "scene": scene.name, "preset": str(path)}
    write_json(folder / "prune.json", head | record(study))
    print(path)
    print(folder / "prune.json")
    others = [word for word in options.overrides if not word.lstrip("+").startswith("reg")]
    print(f"nerfreg train {shlex.join([*others, f'+reg={path.stem}'])}")


def _configuration(overrides: Sequence[str]) -> Config:
    """Compose what `nerfreg train` would run, with the first training view held out."""
    taken = [word for word in overrides if word.lstrip("+").startswith("scene.held_out=")]
    if taken:
        raise NerfregError(f"{taken[0]}: prune chooses itself which training views it holds out")
    config = compose((*overrides, "scene.held_out=[0]"))
    require_steps(config)
    if not any(map(is_used, config.reg.values())):
        raise NerfregError(
            "nothing is selected that could be left out; add +reg=combinerf or a list, "
            "'+reg=[kl,entropy]'"
        )
    return config


def fingerprint(config: Config, stride: int) -> str:
    """Return a hash of all that a measurement depends on beside the trial."""
    scene, train = replace(config.scene, held_out=None), replace(config.train, quiet=False)
    common = as_yaml(replace(config, name=None, seed=0, scene=scene, train=train))
    content = OmegaConf.to_container(OmegaConf.create(common), resolve=True)
    text = json.dumps([__version__, stride, content], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
