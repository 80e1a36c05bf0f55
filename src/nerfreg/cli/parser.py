"""All verbs with their arguments and options: what is parsed, shown by --help, and completed.

Nothing heavy is imported here: `nerfreg VERB --help` must not wait for torch or Hydra.
"""

from __future__ import annotations

from argparse import _SubParsersAction
from importlib.metadata import entry_points
from textwrap import fill
from typing import Any

from nerfreg import __version__
from nerfreg.cli import arguments as read
from nerfreg.cli.arguments import Parser
from nerfreg.cli.completion import complete_overrides, complete_plugins
from nerfreg.config.folders import choices_on_disk, groups_on_disk

DTYPES = ("float16", "bfloat16", "float32", "float64")
"""Precisions of `nerfreg check`, in the order in which they are checked."""

EXAMPLES = """\
examples:
  nerfreg train +reg=combinerf                   all of CombiNeRF, on a scene made on the spot
  nerfreg train '+reg=[kl,lipschitz]' seed=1     a list of plugins
  nerfreg train -m '+reg=[kl],[kl,lipschitz]'    one run for each
  nerfreg train --cfg job +reg=kl                the configuration of a run, without running it
  eval "$(nerfreg -sc install=bash)"             shell completion; also zsh and fish"""


def make_parser() -> Parser:
    """Return the parser of the whole command line."""
    parser = Parser(
        prog="nerfreg",
        usage="nerfreg VERB ... [--debug]",
        description="Few-shot NeRF regularization as plugins.",
        epilog=EXAMPLES,
    )
    parser.add_argument("--version", action="version", version=f"nerfreg {__version__}")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser.add_argument(
        "-sc",
        "--shell-completion",
        metavar="install=SHELL",
        help="print what completes nerfreg in bash, zsh or fish",
    )
    verbs = parser.add_subparsers(
        title="verbs", metavar="VERB", dest="verb", prog="nerfreg", parser_class=Parser
    )
    _add_train(verbs)
    _add_evaluate(verbs)
    _add_render(verbs)
    _add_scene(verbs)
    _add_plugins(verbs)
    _add_check(verbs)
    _add_bench(verbs)
    _add_report(verbs)
    _add_prune(verbs)
    _add_cite(verbs)
    return parser


def parsers_of(parser: Parser) -> dict[str, Parser]:
    """Return the sub-parsers of a parser by name; none if it has none."""
    for action in parser._actions:
        if isinstance(action, _SubParsersAction):
            return dict(action.choices)
    return {}


def _add(verbs: Any, name: str, help: str, usage: str, **settings: Any) -> Parser:
    parser: Parser = verbs.add_parser(
        name,
        help=help,
        description=f"{help[0].upper()}{help[1:]}.",
        usage=f"%(prog)s {usage}".rstrip(),
        **settings,
    )
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    return parser


def _add_run(parser: Parser) -> None:
    parser.add_argument("run", metavar="RUN", help="the folder of a run")


def _add_overrides(parser: Parser) -> None:
    action = parser.add_argument(
        "overrides",
        metavar="OVERRIDE",
        nargs="*",
        help="KEY=VALUE of the configuration, GROUP=CHOICE, or +reg=NAME",
    )
    action.completer = complete_overrides  # type: ignore[attr-defined]


def _choices() -> str:
    """The configuration groups with their choices, for the end of a help text."""
    plugins = {point.name for point in entry_points(group="nerfreg.plugins")}
    lines = []
    for group in groups_on_disk():
        found = choices_on_disk(group) | (plugins if group == "reg" else set())
        choices = ", ".join(sorted(found))
        head = f"  {'+' if group in ('reg', 'experiment') else ''}{group}="
        lines.append(fill(choices, 96, initial_indent=f"{head:<14}", subsequent_indent=" " * 14))
    return "\n".join(["groups and their choices:", *lines])


def _add_hydra_options(parser: Parser) -> None:
    add = parser.add_argument_group("options of Hydra").add_argument
    add("-m", "--multirun", action="store_true", help="a sweep: one job for each combination")
    add(
        "--cfg",
        "-c",
        metavar="WHAT",
        type=read.one_of(("job", "hydra", "all")),
        help="show the configuration, without running it: job, hydra or all",
    )
    add("--package", "-p", metavar="KEY", help="with --cfg: only the part under this key")
    add("--resolve", action="store_true", help="with --cfg: with interpolations resolved")
    add(
        "--info",
        "-i",
        metavar="WHAT",
        nargs="?",
        const="all",
        help="show where the configuration comes from: all, config, defaults, defaults-tree, "
        "plugins or searchpath",
    )
    add("--config-dir", "-cd", metavar="FOLDER", help="another folder of configuration files")
    add("--config-name", "-cn", metavar="NAME", help="another file instead of config.yaml")
    add("--config-path", "-cp", metavar="FOLDER", help="another folder instead of the package's")
    add("--experimental-rerun", metavar="FILE", help="run a pickled configuration of Hydra again")
    add("--run", "-r", action="store_true", help="one job (the default)")
    add("--hydra-help", action="store_true", help="help of Hydra itself")


def _add_train(verbs: Any) -> None:
    parser = _add(
        verbs,
        "train",
        "train on a scene, score it, and leave a run folder",
        "[OVERRIDE ...] [options]",
        epilog=f"{_choices()}\n\nnerfreg train --cfg job shows all keys of a run.",
    )
    _add_overrides(parser)
    _add_hydra_options(parser)


def _add_scene(verbs: Any) -> None:
    parser = _add(
        verbs,
        "scene",
        "show what is found in a scene's files, and a picture of its cameras",
        "[OVERRIDE ...] [options]",
        epilog=_choices(),
    )
    _add_overrides(parser)
    _add_hydra_options(parser)


def _add_evaluate(verbs: Any) -> None:
    parser = _add(
        verbs,
        "evaluate",
        "score a run's checkpoint on the test views again",
        "RUN [OVERRIDE ...]",
        epilog="Overrides change keys of the group eval, e.g. "
        "eval.lpips_weights=weights.safetensors.",
    )
    _add_run(parser)
    parser.add_argument("overrides", metavar="OVERRIDE", nargs="*", help="KEY=VALUE")


def _add_render(verbs: Any) -> None:
    parser = _add(
        verbs,
        "render",
        "render test views, or a camera path to videos",
        "RUN [KEY=VALUE ...]",
        epilog="""\
keys:
  path=test|spiral|orbit   test views as PNG, or a camera path as videos (test)
  frames=N                 frames of a video (60)
  fps=N                    frames per second (30)
  format=gif|mp4           format of a video (gif); mp4 needs pip install 'nerfreg[video]'
  out=FOLDER               where the files go (RUN/renders)""",
    )
    _add_run(parser)
    action = parser.add_argument("keys", metavar="KEY=VALUE", nargs="*", help="see below")
    keys = (
        "path=test",
        "path=spiral",
        "path=orbit",
        "frames=",
        "fps=",
        "format=gif",
        "format=mp4",
        "out=",
    )
    action.completer = lambda prefix, **_: [key for key in keys if key.startswith(prefix)]  # type: ignore[attr-defined]


def _add_plugins(verbs: Any) -> None:
    _add(verbs, "plugins", "list the installed regularizers", "")


def _add_check(verbs: Any) -> None:
    parser = _add(
        verbs,
        "check",
        "check plugins against stiff and extreme cases",
        "[PLUGIN ...] [reg.NAME.KEY=VALUE ...] [options]",
    )
    action = parser.add_argument(
        "plugins",
        metavar="PLUGIN",
        nargs="*",
        help="names of plugins, or `compositing`; all if none. reg.NAME.KEY=VALUE configures one",
    )
    action.completer = complete_plugins  # type: ignore[attr-defined]
    add = parser.add_argument
    add("--case", metavar="NAME", help="only this case")
    add(
        "--dtype",
        metavar="NAME",
        type=read.one_of(DTYPES),
        help=f"only this precision: {', '.join(DTYPES)}",
    )
    add("--samples", metavar="N", type=read.count, help="only this number of samples a ray")
    add("--replay", metavar="FILE", help="render a step again that training left out and saved")
    add("--json", action="store_true", help="print one JSON document")
    add("--list", action="store_true", help="list the cases")


def _add_bench(verbs: Any) -> None:
    parser = _add(
        verbs,
        "bench",
        "measure error against run time of what nerfreg computes",
        "NAME ... [options]",
        epilog="nerfreg bench NAME --help shows the options of one. The last line that step and "
        "render print is JSON.",
    )
    benches = parser.add_subparsers(
        title="benches", metavar="NAME", dest="bench", prog="nerfreg bench", parser_class=Parser
    )
    steps = ("--steps", "N", read.count, "number of steps to time")
    options: dict[str, tuple[str, str, tuple[tuple[str, str, Any, str], ...]]] = {
        "quadrature": ("a rendered ray: error against run time", "", ()),
        "losses": ("every plugin's loss: error and run time", "", ()),
        "step": (
            "a training step and its parts",
            "overrides",
            (
                steps,
                ("--warmup", "N", read.count, "number of steps before those that are timed"),
                ("--at", "SHARE", read.share, "share of the budget that schedules see, 0 to 1"),
            ),
        ),
        "overhead": (
            "each regularizer and preset against vanilla",
            "overrides",
            (steps, ("--only", "NAME,NAME", read.names, "names of plugins and presets")),
        ),
        "render": (
            "test views of a run",
            "run",
            (("--views", "N", read.count, "number of views to time"),),
        ),
        "scaling": ("a step against rays, samples, levels and table size", "overrides", (steps,)),
    }
    for name, (help, takes, own) in options.items():
        usage = {"overrides": "[OVERRIDE ...] [options]", "run": "RUN [options]"}
        bench = _add(benches, name, help, usage.get(takes, "[options]"))
        if takes == "overrides":
            _add_overrides(bench)
        elif takes == "run":
            _add_run(bench)
        bench.add_argument(
            "-o",
            metavar="FOLDER",
            dest="folder",
            type=read.folder,
            help=f"a folder to write to (bench/{name})",
        )
        bench.add_argument("--quick", action="store_true", help="at small sizes, as a test")
        for option, metavar, kind, text in own:
            bench.add_argument(option, metavar=metavar, type=kind, help=text)


def _add_report(verbs: Any) -> None:
    parser = _add(
        verbs,
        "report",
        "write tables, plots and a page of error against run time",
        "RUNS... [options]",
        epilog="Written: tables.md, tables/*.tex, methods.csv, runs.csv, figures and report.html.",
    )
    add = parser.add_argument
    add("runs", metavar="RUNS", nargs="+", help="folders of runs")
    add(
        "-o",
        metavar="FOLDER",
        dest="folder",
        type=read.folder,
        default="report",
        help="a folder to write to (report)",
    )
    add(
        "--paper",
        metavar="FILE",
        help="a CSV file of published numbers, with the columns "
        "dataset, views, scene, method, psnr, ssim, lpips, average",
    )
    add(
        "--psnr",
        metavar="DB",
        type=read.decibels,
        help="a PSNR in dB to which training is timed (the published one of vanilla)",
    )
    add(
        "--views",
        metavar="NAME,NAME",
        type=read.names,
        default=(),
        help="test views to show pictures of",
    )


def _add_prune(verbs: Any) -> None:
    parser = _add(
        verbs,
        "prune",
        "find the regularizers that a scene can do without",
        "[OVERRIDE ...] [options]",
        epilog="Overrides are those of nerfreg train, and select what is judged: "
        "scene=... +reg=combinerf.\nNo test view is read. The same command continues a study "
        "that was stopped.",
    )
    _add_overrides(parser)
    add = parser.add_argument
    add(
        "--budget",
        metavar="SECONDS",
        type=read.positive,
        default=3600.0,
        help="seconds for all trainings together (3600)",
    )
    add(
        "--steps",
        metavar="N",
        type=read.count,
        help="steps of the first trainings (a quarter of train.steps); undecided comparisons "
        "continue with twice as many",
    )
    add(
        "--folds",
        metavar="K",
        type=read.count,
        help="folds of the training views, one of which is held out at a time "
        "(4, or one for each view)",
    )
    add(
        "--tolerance",
        metavar="DB",
        type=read.positive,
        default=0.1,
        help="dB that count as no difference (0.1)",
    )
    add(
        "--stride",
        metavar="N",
        type=read.count,
        default=2,
        help="score every N-th row and column (2); 1 adds LPIPS and the average",
    )
    add(
        "--name",
        metavar="NAME",
        help="name of the preset conf/reg/NAME.yaml (pruned_SCENE), which +reg=NAME selects",
    )
    add(
        "-o",
        metavar="FOLDER",
        dest="folder",
        type=read.folder,
        help="a folder for cells.jsonl and prune.json (prune/SCENE)",
    )


def _add_cite(verbs: Any) -> None:
    _add_run(_add(verbs, "cite", "print BibTeX of everything that a run used", "RUN"))
