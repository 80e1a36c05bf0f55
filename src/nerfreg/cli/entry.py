"""The entrance: find the verb, run it, and turn errors into one line and an exit code."""

from __future__ import annotations

import os
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from nerfreg import __version__
from nerfreg.cli import verbs
from nerfreg.cli.arguments import Parser
from nerfreg.cli.completion import answer_completion, print_shell_code
from nerfreg.cli.parser import make_parser, parsers_of
from nerfreg.errors import NerfregError, NerfregWarning, nearest

COMPLETION = ("-sc", "--shell-completion")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line.

    Args:
        arguments: The words after `nerfreg`; those of the process if None.

    Returns:
        The exit code: 0; 1 if checks or jobs failed; 2 for wrong input; 3 for a run that was not
        finite; 130 after Ctrl-C; 141 if nobody reads what is printed.
    """
    # Threads that wait must not spin: two pools, torch's and numba's, take turns on the same
    # cores. OpenMP reads this when torch is imported.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    try:
        with _warnings_in_one_line():
            code = _dispatch(words) or 0
        # Here, where a reader that has gone is no error yet, and not when the interpreter ends.
        sys.stdout.flush()
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
        # `nerfreg plugins | head`: nobody reads on, and the interpreter must not fail when it
        # flushes.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Within this context, warnings of nerfreg are one line each, and others as Python shows them.

    Each text is shown once. While a progress bar is live, what is printed appears above it.
    """
    with warnings.catch_warnings():
        # Python's own memory of what it has shown is by place in the code, and a second run of the
        # same process has warnings of its own.
        warnings.simplefilter("always", NerfregWarning)
        python_shows = warnings.showwarning
        shown: set[str] = set()

        def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if not issubclass(category, NerfregWarning):
                python_shows(message, category, *place, **more)
            elif str(message) not in shown:
                shown.add(str(message))
                print(f"nerfreg: warning: {message}", file=sys.stderr)

        warnings.showwarning = show
        yield


def _dispatch(words: list[str]) -> int | None:
    parser = make_parser()
    answer_completion(parser)
    if not words or words[0] in ("-h", "--help", "help"):
        parser.print_help()
        return 0
    if words[0] == "--version":
        print(f"nerfreg {__version__}")
        return 0
    if words[0] in COMPLETION:
        print_shell_code(words[1] if len(words) > 1 else "")
        return 0
    chosen, rest = _select(parser, words)
    if {"-h", "--help"} & set(rest):
        chosen.print_help()
        return 0
    run = getattr(verbs, chosen.verb.split()[0].replace("-", "_"))
    code: int | None = run(chosen.read(rest), rest)
    return code


def _select(parser: Parser, words: Sequence[str]) -> tuple[Parser, list[str]]:
    """The innermost parser that the first words name, and the words after these."""
    rest = [*words]
    while known := parsers_of(parser):
        what = "bench" if parser.verb else "verb"
        if not rest or rest[0] in ("-h", "--help"):
            if rest:
                break
            raise NerfregError(f"{parser.verb} needs a name first; known: {', '.join(known)}")
        if rest[0] not in known:
            raise NerfregError(f"unknown {what} '{rest[0]}'; {nearest(rest[0], known)}")
        parser = known[rest.pop(0)]
    return parser, rest
