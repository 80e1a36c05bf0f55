"""The arguments of the tools: new-plugin, check, bench, report and prune."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from nerfreg.cli import arguments as read
from nerfreg.cli.arguments import Parser
from nerfreg.cli.common import add_overrides, add_run, add_verb
from nerfreg.cli.completion import complete_plugins

DTYPES = ("float16", "bfloat16", "float32", "float64")
"""Precisions of `nerfreg check`, in the order in which they are checked."""


def add_new_plugin(verbs: Any) -> None:
    """Add `nerfreg new-plugin`."""
    parser = add_verb(
        verbs,
        "new-plugin",
        "write a package with a regularizer of your own, to be filled in",
        "NAME [options]",
        epilog="The package installs, passes nerfreg check, and trains as it is.\n"
        "Hooks are named with or without nerfreg_; docs/reference/hooks.md describes them.",
    )
    add = parser.add_argument
    add("name", metavar="NAME", help="the name of the plugin, such as depth_ranking")
    add(
        "--hook",
        metavar="NAME,NAME",
        dest="hooks",
        type=read.names,
        default=("loss",),
        help="the hooks that it implements (loss); all for all of them",
    )
    add("--folder", metavar="PATH", type=Path, help="a new folder for it (./nerfreg-NAME)")


def add_check(verbs: Any) -> None:
    """Add `nerfreg check`."""
    parser = add_verb(
        verbs,
        "check",
        "check plugins against stiff and extreme cases",
        "[PLUGIN ...] [reg.NAME.KEY=VALUE ...] [options]",
    )
    action: Any = parser.add_argument(
        "plugins",
        metavar="PLUGIN",
        nargs="*",
        help="names of plugins, or `compositing`; all if none. reg.NAME.KEY=VALUE configures one",
    )
    action.completer = complete_plugins
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


def add_bench(verbs: Any) -> None:
    """Add `nerfreg bench`, with a sub-parser for each bench."""
    parser = add_verb(
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
        bench = add_verb(benches, name, help, usage.get(takes, "[options]"))
        bench.set_defaults(bench=name)
        if takes == "overrides":
            add_overrides(bench)
        elif takes == "run":
            add_run(bench)
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


def add_report(verbs: Any) -> None:
    """Add `nerfreg report`."""
    parser = add_verb(
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


def add_prune(verbs: Any) -> None:
    """Add `nerfreg prune`."""
    parser = add_verb(
        verbs,
        "prune",
        "find the regularizers that a scene can do without",
        "[OVERRIDE ...] [options]",
        epilog="Overrides are those of nerfreg train, and select what is judged: "
        "scene=... +reg=combinerf.\nNo test view is read. The same command continues a study "
        "that was stopped.",
    )
    add_overrides(parser)
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
