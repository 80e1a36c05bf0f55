"""The command line as its parser describes it."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from unittest import mock

from nerfreg_docs.markdown import code, plain, table


def command_line() -> str:
    """All verbs of `nerfreg`, their arguments and options."""
    from nerfreg.cli.parser import make_parser

    return describe(make_parser())


def describe(parser: argparse.ArgumentParser, level: int = 2) -> str:
    """A parser as Markdown: its usage, arguments and sub-commands, under headings of `level`."""
    parts = [_usage(parser), plain(parser.description or ""), _arguments(parser)]
    if parser.epilog:
        parts.append(_literal(parser.epilog))
    for name, child in _commands(parser):
        parts += [f"{'#' * level} {child.prog or name}", describe(child, level + 1)]
    return "\n\n".join(part for part in parts if part)


def _usage(parser: argparse.ArgumentParser) -> str:
    with mock.patch.dict(os.environ, {"COLUMNS": "90"}):
        return _literal(parser.format_usage().removeprefix("usage: "))


def _literal(text: str) -> str:
    return f"```text\n{text.strip(chr(10))}\n```"


def _arguments(parser: argparse.ArgumentParser) -> str:
    shown = [
        action
        for action in parser._actions
        if action.help != argparse.SUPPRESS
        and not isinstance(action, argparse._SubParsersAction | argparse._HelpAction)
    ]
    # As in the usage: what is told by its position comes before options, and these as declared.
    shown.sort(key=lambda action: bool(action.option_strings))
    rows = [[_name(action), _help(parser, action)] for action in shown]
    return table(["argument", "meaning"], rows) if rows else ""


def _name(action: argparse.Action) -> str:
    if action.choices is not None and action.metavar is None:
        value = f"{{{','.join(map(str, action.choices))}}}"
    else:
        metavar = action.metavar or action.dest.upper()
        value = metavar if isinstance(metavar, str) else " ".join(metavar)
    if not action.option_strings:
        return code(action.metavar if isinstance(action.metavar, str) else action.dest)
    suffix = "" if action.nargs == 0 else f" {value}"
    return ", ".join(code(option + suffix) for option in action.option_strings)


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    formatter = argparse.HelpFormatter(parser.prog)
    return plain(formatter._expand_help(action) if action.help else "")


def _commands(
    parser: argparse.ArgumentParser,
) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield from action.choices.items()
