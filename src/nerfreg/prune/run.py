"""`nerfreg prune`: one study from beginning to end."""

from __future__ import annotations

import hashlib
import json
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from omegaconf import OmegaConf
from rich.console import Console

from nerfreg import __version__
from nerfreg.analysis.tables import write_record
from nerfreg.config.compose import compose, require_steps
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError
from nerfreg.prune.ledger import CELLS, CellFile, Ledger
from nerfreg.prune.plan import Design, make_folds, make_ladder
from nerfreg.prune.preset import plain, preset_name, preset_path, write_preset
from nerfreg.prune.record import record
from nerfreg.prune.report import conclusions, print_report
from nerfreg.prune.study import Study
from nerfreg.prune.summary import Summary
from nerfreg.prune.trials import Trials

RECORD = "prune.json"


@dataclass(frozen=True)
class PruneOptions:
    """overrides: those of `nerfreg train`. budget: seconds of the whole study. folds: of the training views; None:
    up to four. steps: of the first trainings; None: a quarter of train.steps. tolerance: dB that count as nothing.
    stride: of the rows and columns that are scored. name: of the preset. folder: where the files go."""

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
    console = Console(stderr=True)
    config, full = _configuration(options)
    trials = Trials(
        config, options.stride, lambda line: console.print(line, highlight=False, markup=False)
    )
    scene = trials.scene
    path = preset_path(options.name or preset_name(scene.name))
    folder = options.folder or Path("prune", plain(scene.name))
    folds, ladder = (
        make_folds(trials.views, options.folds),
        make_ladder(options.steps, config.train.steps),
    )
    design = Design(full, folds, ladder, config.seed)
    measured = CellFile(folder, fingerprint(config, options.stride), trials)
    ledger = Ledger(measured)
    with console.status("", refresh_per_second=2) as status:
        study = Study(
            design,
            ledger,
            options.budget,
            options.tolerance,
            _teller(console, status.update, config),
        )
        try:
            outcome = study.run()
        except KeyboardInterrupt:
            print(
                f"{folder / CELLS} keeps what is measured; the same command goes on from there",
                file=sys.stderr,
            )
            raise
    if measured.reused:
        print(f"{measured.reused} of {len(ledger.trials)} trainings were found in {folder / CELLS}")
    summary = Summary(
        scene.name, trials.views, design, ledger, outcome, options.tolerance, options.budget
    )
    print_report(summary, Console())
    layout_known = replace(config, scene=replace(config.scene, layout=scene.layout))
    write_preset(path, layout_known, outcome.pruned, _comments(summary, command))
    write_record(folder / RECORD, record(summary, command, str(path)))
    print(path)
    print(folder / RECORD)
    others = [word for word in options.overrides if not word.lstrip("+").startswith("reg")]
    print(f"nerfreg train {shlex.join([*others, f'+reg={path.stem}'])}")


def _configuration(options: PruneOptions) -> tuple[Config, tuple[str, ...]]:
    """What `nerfreg train` would run, its first training view held out, and what is selected with a weight above 0."""
    if taken := next(
        (word for word in options.overrides if word.lstrip("+").startswith("scene.held_out=")), None
    ):
        raise NerfregError(f"{taken}: prune chooses itself which training views it holds out")
    config = compose((*options.overrides, "scene.held_out=[0]"))
    require_steps(config)
    full = tuple(str(name) for name, plugin in config.reg.items() if plugin.weight != 0)
    if not full:
        raise NerfregError(
            "nothing is selected that could be left out; add +reg=combinerf or a list, '+reg=[kl,entropy]'"
        )
    return config, full


def fingerprint(config: Config, stride: int) -> str:
    """Of all that a measurement depends on beside the trial."""
    ignored = {"name": None, "seed": 0, "scene": replace(config.scene, held_out=None)}
    quiet = replace(config.train, quiet=False)
    content = OmegaConf.to_container(
        OmegaConf.structured(replace(config, **ignored, train=quiet)),
        resolve=True,
        enum_to_str=True,
    )
    text = json.dumps([__version__, stride, content], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _teller(
    console: Console, update: Callable[[str], None], config: Config
) -> Callable[[str], None]:
    """Where a line about every trial goes: onto one line of a terminal, else below each other."""
    if config.train.quiet:
        return lambda line: None
    if console.is_terminal:
        return update
    return lambda line: console.print(line, highlight=False, markup=False, soft_wrap=True)


def _comments(summary: Summary, command: Sequence[str]) -> list[str]:
    full = "+".join(summary.design.full)
    return [
        f"of {full} on {summary.scene} with {summary.views} views.",
        shlex.join(command),
        *conclusions(summary),
    ]
