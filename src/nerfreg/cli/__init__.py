"""The command line: one entrance, `main`."""

from nerfreg.cli.verbs import main

__all__ = ["main"]
