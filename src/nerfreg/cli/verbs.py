"""What each verb does: a thin call into the package.

A verb is given the options that the parser read and the words that they were read from. It imports
what it needs when it runs: torch takes seconds, and `nerfreg --help` must not wait for it.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from nerfreg.errors import NerfregError

Words = Sequence[str]


def train(options: Namespace, words: Words) -> int:
    """Train, once or as a sweep; Hydra reads the words itself."""
    from nerfreg.cli import launch
    from nerfreg.runs.files import RESULTS

    return launch.launch(words, launch.train, leaves=RESULTS)


def scene(options: Namespace, words: Words) -> int:
    """Describe a scene and draw its cameras."""
    from nerfreg.cli import launch

    return launch.launch(words, launch.show_scene)


def evaluate(options: Namespace, words: Words) -> None:
    """Score a run again."""
    run = _run_folder(options)
    from nerfreg.runs.evaluate import evaluate_run

    evaluate_run(run, options.overrides)


def render(options: Namespace, words: Words) -> None:
    """Render test views or a camera path."""
    run = _run_folder(options)
    from nerfreg.cli.render_options import parse_render_options
    from nerfreg.runs.render import render_run

    chosen = parse_render_options(options.keys)
    out = Path(chosen.out) if chosen.out else run / "renders"
    render_run(run, chosen.path, out, chosen.frames, chosen.fps, chosen.format)


def cite(options: Namespace, words: Words) -> None:
    """Print the BibTeX entries of a run."""
    run = _run_folder(options)
    from nerfreg.runs.citations import cite

    print(cite(run))


def plugins(options: Namespace, words: Words) -> None:
    """Print a table of the installed plugins."""
    from nerfreg.cli.plugins import print_plugins

    print_plugins()


def new_plugin(options: Namespace, words: Words) -> None:
    """Write the package of a new plugin."""
    from nerfreg.scaffold.run import run

    run(options.name, options.hooks, options.folder)


def check(options: Namespace, words: Words) -> int:
    """Check plugins, or replay a step; returns 1 if anything failed."""
    if options.replay is not None:
        from nerfreg.runs.replay import replay

        return replay(Path(options.replay))
    from nerfreg.checks import run as checks

    if options.list:
        print(checks.listing())
        return 0
    chosen = options.case, options.dtype, options.samples
    return checks.run(options.plugins, *chosen, options.json)


def bench(options: Namespace, words: Words) -> int:
    """Run one bench at its full or quick sizes."""
    from nerfreg.bench.run import run

    given = {"overrides", "run"} & vars(options).keys()
    arguments = options.overrides if "overrides" in given else [options.run] if given else None
    chosen = ("steps", "warmup", "at", "only", "views")
    sizes = {name: value for name in chosen if (value := getattr(options, name, None)) is not None}
    folder = options.folder or Path("bench", options.bench)
    return run(options.bench, folder, sizes, arguments, quick=options.quick)


def report(options: Namespace, words: Words) -> None:
    """Write a report on some runs."""
    from nerfreg.reports.write import write_report

    paper = Path(options.paper) if options.paper else None
    runs = [Path(run) for run in options.runs]
    write_report(runs, Path(options.folder), paper, options.psnr, options.views)


def prune(options: Namespace, words: Words) -> None:
    """Study which regularizers a scene can do without."""
    from nerfreg.prune.run import PruneOptions, run

    chosen = PruneOptions(
        tuple(options.overrides),
        options.budget,
        options.folds,
        options.steps,
        options.tolerance,
        options.stride,
        options.name,
        options.folder,
    )
    run(chosen, ("nerfreg", "prune", *words))


def _run_folder(options: Namespace) -> Path:
    """The run that is named; anything that has been trained has `.hydra/config.yaml`."""
    run = Path(options.run)
    if not (run / ".hydra" / "config.yaml").is_file():
        raise NerfregError(f"{run}: not the folder of a run (no .hydra/config.yaml in it)")
    return run
