"""Shell completion: verbs and options come from the parser, overrides from Hydra."""

from __future__ import annotations

import os
from argparse import ArgumentParser, Namespace
from contextlib import redirect_stdout
from importlib.metadata import entry_points
from io import StringIO
from typing import Any

from nerfreg.errors import NerfregError, nearest

SHELLS = ("bash", "zsh", "fish")


def print_shell_code(request: str) -> None:
    """Print what a shell evaluates to complete `nerfreg`.

    Args:
        request: "install=SHELL", as Hydra's own option takes it.

    Raises:
        NerfregError: The request or the shell is not known.
    """
    # Only whoever completes needs it.
    from argcomplete.shell_integration import shellcode

    action, _, shell = request.partition("=")
    if action != "install":
        raise NerfregError(f"-sc {request}: write install=bash, install=zsh or install=fish")
    if shell not in SHELLS:
        raise NerfregError(f"-sc {request}: {nearest(shell, SHELLS)}")
    print(shellcode(["nerfreg"], shell=shell))


def answer_completion(parser: ArgumentParser) -> None:
    """Answer the shell and exit, if it is the shell that asks; else return at once."""
    if "_ARGCOMPLETE" not in os.environ:
        return
    import argcomplete

    argcomplete.autocomplete(parser, always_complete_options=False)


def complete_plugins(prefix: str, **_: Any) -> list[str]:
    """Return the names of plugins that begin with `prefix`."""
    names = (point.name for point in entry_points(group="nerfreg.plugins"))
    return sorted(name for name in names if name.startswith(prefix))


def complete_overrides(prefix: str, parsed_args: Namespace, **_: Any) -> list[str]:
    """Return what Hydra completes an override to.

    Args:
        prefix: What has been typed of it.
        parsed_args: Holds the overrides before it.
    """
    # Imports torch; completing verbs and options must not wait for that.
    from nerfreg.cli.launch import launch, train
    from nerfreg.config.plugin_store import values_of
    from nerfreg.config.search_path import SCHEMA
    from nerfreg.registry import installed

    before = getattr(parsed_args, "overrides", None) or []
    key, equals, typed = prefix.partition("=")
    if equals and (values := values_of(key, before, installed())):
        return [f"{key}={value}" for value in values if value.startswith(typed)]
    os.environ["COMP_LINE"] = " ".join(["nerfreg", *before, prefix])
    found = StringIO()
    with redirect_stdout(found):
        launch(["-sc", "query=bash"], train)
    # The nodes that hold types are listed by files, and are no choices.
    return [word for word in found.getvalue().split() if not word.endswith(SCHEMA)]
