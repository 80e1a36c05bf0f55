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
from nerfreg.cli import tools
from nerfreg.cli.arguments import Parser
from nerfreg.cli.common import add_overrides, add_run, add_verb
from nerfreg.config.folders import choices_on_disk, groups_on_disk

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
    parser.add_argument(
        "--version", action="version", version=f"nerfreg {__version__}", help="print the version"
    )
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
    choices = _choices()
    keys = "nerfreg train --cfg job shows all keys of a run."
    training = "train on a scene, score it, and leave a run folder"
    _add_hydra_verb(verbs, "train", training, f"{choices}\n\n{keys}")
    _add_evaluate(verbs)
    _add_render(verbs)
    inspecting = "show what is found in a scene's files, and a picture of its cameras"
    _add_hydra_verb(verbs, "scene", inspecting, choices)
    _add_plugins(verbs)
    tools.add_new_plugin(verbs)
    tools.add_check(verbs)
    tools.add_bench(verbs)
    tools.add_report(verbs)
    tools.add_prune(verbs)
    _add_cite(verbs)
    return parser


def parsers_of(parser: Parser) -> dict[str, Parser]:
    """Return the sub-parsers of a parser by name; none if it has none."""
    for action in parser._actions:
        if isinstance(action, _SubParsersAction):
            return dict(action.choices)
    return {}


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


def _add_hydra_verb(verbs: Any, name: str, help: str, epilog: str) -> None:
    parser = add_verb(verbs, name, help, "[OVERRIDE ...] [options]", epilog=epilog)
    add_overrides(parser)
    _add_hydra_options(parser)


def _add_evaluate(verbs: Any) -> None:
    parser = add_verb(
        verbs,
        "evaluate",
        "score a run's checkpoint on the test views again",
        "RUN [OVERRIDE ...]",
        epilog="Overrides change keys of the group eval, e.g. "
        "eval.lpips_weights=weights.safetensors.",
    )
    add_run(parser)
    parser.add_argument("overrides", metavar="OVERRIDE", nargs="*", help="KEY=VALUE")


def _add_render(verbs: Any) -> None:
    parser = add_verb(
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
    add_run(parser)
    action: Any = parser.add_argument("keys", metavar="KEY=VALUE", nargs="*", help="see below")
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
    action.completer = lambda prefix, **_: [key for key in keys if key.startswith(prefix)]


def _add_plugins(verbs: Any) -> None:
    add_verb(verbs, "plugins", "list the installed regularizers", "")


def _add_cite(verbs: Any) -> None:
    add_run(add_verb(verbs, "cite", "print BibTeX of everything that a run used", "RUN"))
