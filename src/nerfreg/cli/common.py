"""What several verbs share: how a sub-parser is made, runs and overrides."""

from __future__ import annotations

from typing import Any

from nerfreg.cli.arguments import Parser
from nerfreg.cli.completion import complete_overrides


def add_verb(verbs: Any, name: str, help: str, usage: str, **settings: Any) -> Parser:
    """Add the sub-parser of a verb.

    Args:
        verbs: What `add_subparsers` returned.
        name: Of the verb.
        help: What it does, in a line.
        usage: What follows its name.
        settings: Further ones of the parser.
    """
    parser: Parser = verbs.add_parser(
        name,
        help=help,
        description=f"{help[0].upper()}{help[1:]}.",
        usage=f"%(prog)s {usage}".rstrip(),
        **settings,
    )
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    return parser


def add_run(parser: Parser) -> None:
    """Let a verb take the folder of a run."""
    parser.add_argument("run", metavar="RUN", help="the folder of a run")


def add_overrides(parser: Parser) -> None:
    """Let a verb take overrides, which Hydra completes."""
    action: Any = parser.add_argument(
        "overrides",
        metavar="OVERRIDE",
        nargs="*",
        help="KEY=VALUE of the configuration, GROUP=CHOICE, or +reg=NAME",
    )
    action.completer = complete_overrides
