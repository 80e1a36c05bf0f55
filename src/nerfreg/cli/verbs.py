"""`nerfreg VERB [overrides]`. A verb is a thin call into the package."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from nerfreg import __version__
from nerfreg.errors import NerfregError

# Verbs import what they need when they run: torch takes seconds, and `nerfreg --help` must not wait for it.


@dataclass(frozen=True)
class Verb:
    """usage: what follows the verb. help: one line. run: takes the arguments after it, and may return an exit code."""

    usage: str
    help: str
    run: Callable[[list[str]], int | None]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line; returns the exit code."""
    # Threads that wait must not spin: two pools, torch's and numba's, take turns on the same cores. OpenMP reads this
    # when torch is imported.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    try:
        code = _dispatch(words) or 0
        sys.stdout.flush()  # here, where a reader that has gone is no error yet, and not when the interpreter ends
        return code
    except NerfregError as error:
        if debug:
            traceback.print_exc()
        print(f"nerfreg: error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        if debug:
            traceback.print_exc()
        print("nerfreg: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # `nerfreg plugins | head`: nobody reads on, and the interpreter must not fail when it flushes.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


def _dispatch(words: list[str]) -> int | None:
    if not words or words[0] in ("-h", "--help", "help"):
        print(_help())
    elif words[0] == "--version":
        print(f"nerfreg {__version__}")
    elif words[0] in ("-sc", "--shell-completion"):
        _complete(words)
    elif words[0] not in VERBS:
        close = get_close_matches(words[0], VERBS, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"verbs: {', '.join(VERBS)}"
        raise NerfregError(f"unknown verb '{words[0]}'; {hint}")
    elif words[0] not in HYDRA_VERBS and {"-h", "--help"} & set(words):
        print(_verb_help(words[0]))
    else:
        return VERBS[words[0]].run(words[1:])
    return None


def _help() -> str:
    usages = {f"{name} {verb.usage}": verb.help for name, verb in VERBS.items()}
    width = max(map(len, usages)) + 2
    lines = [f"  {usage:<{width}}{text}" for usage, text in usages.items()]
    return "\n".join(
        [
            "usage: nerfreg VERB [overrides] [--debug]",
            "",
            "Few-shot NeRF regularization as plugins.",
            "",
            *lines,
            "",
            "  nerfreg train +reg=combinerf                     all of CombiNeRF, on a scene made here",
            "  nerfreg train '+reg=[kl,lipschitz]' seed=1       a list of plugins",
            "  nerfreg train -m '+reg=[kl],[kl,lipschitz]'      one run for each",
            "  nerfreg train --help                             groups and keys",
            "  nerfreg train --cfg job +reg=kl                  the configuration of a run, without running it",
            '  eval "$(nerfreg -sc install=bash)"               shell completion',
            "",
            "  --version   --debug (show tracebacks)",
        ]
    )


def _train(words: list[str]) -> int:
    from nerfreg.cli import launch

    return launch.launch(words, launch.train, leaves="results.json")


def _scene(words: list[str]) -> int:
    from nerfreg.cli import launch

    return launch.launch(words, launch.show_scene)


def _evaluate(words: list[str]) -> None:
    run = _run_folder("evaluate", words)
    from nerfreg.runs.evaluate import evaluate_run

    evaluate_run(run, words[1:])


def _render(words: list[str]) -> None:
    run = _run_folder("render", words)
    from nerfreg.cli.render_options import parse_render_options
    from nerfreg.runs.render import render_run

    options = parse_render_options(words[1:])
    out = Path(options.out) if options.out else run / "renders"
    render_run(
        run, options.path, out, frames=options.frames, fps=options.fps, format=options.format
    )


def _cite(words: list[str]) -> None:
    run = _run_folder("cite", words)
    if words[1:]:
        raise NerfregError(f"cite takes a run folder and nothing else, got '{words[1]}'")
    from nerfreg.runs.citations import cite

    print(cite(run))


def _plugins(words: list[str]) -> None:
    if words:
        raise NerfregError(f"plugins takes no argument, got '{words[0]}'")
    from nerfreg.cli.plugins import print_plugins

    print_plugins()


def _check(words: list[str]) -> int:
    from nerfreg.cli.check import run

    return run(words)


def _bench(words: list[str]) -> int:
    from nerfreg.cli.bench import run

    return run(words)


def _report(words: list[str]) -> int:
    from nerfreg.cli.report import run

    return run(words)


def _prune(words: list[str]) -> int:
    from nerfreg.cli.prune import run

    return run(words)


VERBS = {
    "train": Verb("[overrides]", "train on a scene; Hydra overrides choose everything", _train),
    "evaluate": Verb(
        "RUN [overrides]", "score a run's checkpoint on the test views again", _evaluate
    ),
    "render": Verb("RUN [options]", "render test views, or a path to a video", _render),
    "scene": Verb(
        "[overrides]", "what is found in a scene's files, and a picture of its cameras", _scene
    ),
    "plugins": Verb("", "the installed regularizers", _plugins),
    "check": Verb("[PLUGIN ...] [options]", "plugins against stiff and extreme cases", _check),
    "bench": Verb("NAME [options]", "error against run time of what nerfreg computes", _bench),
    "report": Verb(
        "RUNS... [options]", "tables, plots and a page of error against run time", _report
    ),
    "prune": Verb("[overrides] [options]", "which regularizers a scene can do without", _prune),
    "cite": Verb("RUN", "BibTeX of everything that a run used", _cite),
}
HYDRA_VERBS = ("train", "scene")
DETAILS = {
    "evaluate": "Overrides change keys of the group eval, e.g. eval.lpips_weights=weights.safetensors.",
    "check": "Options: --case NAME  --dtype NAME  --samples N  --replay FILE  --json  --list (the cases)",
    "bench": """\
  quadrature              a rendered ray: error against run time
  losses                  every plugin's loss: error and run time
  step [overrides]        a training step and its parts: --steps N  --warmup N  --at SHARE (of the budget)
  overhead [overrides]    each regularizer and preset against vanilla: --steps N  --only NAME,NAME
  scaling [overrides]     a step against rays, samples, levels and table size: --steps N
  render RUN              test views of a run: --views N

Options of all: -o FOLDER (default bench/NAME)  --quick
Overrides are those of nerfreg train. The last line that step and render print is JSON.""",
    "report": """\
RUNS are folders of runs, or above them; runs may still be going on. Written: tables.md, tables/*.tex, methods.csv,
runs.csv, figures and report.html.

  -o FOLDER           to write to (report)
  --paper FILE        published numbers beside those of runs: a CSV file with the columns
                      dataset, views, scene, method, psnr, ssim, lpips, average
  --psnr DB           time training to this PSNR (the published one of vanilla)
  --views NAME,NAME   test views to show pictures of""",
    "prune": """\
Overrides are those of nerfreg train, and select what is to be judged: scene=... +reg=combinerf. No test view is read.

  --budget SECONDS    for all trainings together (3600)
  --steps N           of the first trainings (a quarter of train.steps); the undecided go on with twice as many
  --folds K           of the training views, one of which is held out at a time (4, or one for each view)
  --tolerance DB      what counts as no difference (0.1)
  --stride N          score every N-th row and column (2); 1: LPIPS and the average besides
  --name NAME         of the preset conf/reg/NAME.yaml (pruned_SCENE), which +reg=NAME selects
  -o FOLDER           for cells.jsonl and prune.json (prune/SCENE); the same command goes on where it was stopped""",
    "render": "Options: path=test|spiral|orbit  frames=60  fps=30  format=mp4|gif  out=FOLDER (default RUN/renders)",
}


def _verb_help(name: str) -> str:
    return "\n\n".join(
        filter(
            None,
            (f"usage: nerfreg {name} {VERBS[name].usage}", VERBS[name].help, DETAILS.get(name)),
        )
    )


def _run_folder(verb: str, words: list[str]) -> Path:
    """The run that the first word names; anything that has been trained has `.hydra/config.yaml`."""
    if not words:
        raise NerfregError(f"{verb} needs the folder of a run: nerfreg {verb} RUN")
    run = Path(words[0])
    if not (run / ".hydra" / "config.yaml").is_file():
        raise NerfregError(f"{run}: not the folder of a run (no .hydra/config.yaml in it)")
    return run


def _complete(words: list[str]) -> None:
    """Complete verbs; hand everything else to Hydra, which knows nothing of verbs."""
    if "query=bash" in words:
        program, _, line = os.environ.get("COMP_LINE", "").lstrip().partition(" ")
        verb, space, rest = line.lstrip().partition(" ")
        if not space:
            print(" ".join(name for name in VERBS if name.startswith(verb)))
            return
        if verb not in HYDRA_VERBS:
            return
        os.environ["COMP_LINE"] = f"{program} {rest}"
    from nerfreg.cli import launch

    launch.launch(words, launch.train)
