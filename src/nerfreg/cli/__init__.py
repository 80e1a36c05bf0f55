"""The command line: one entrance, `main`."""

from nerfreg.cli.entry import main

__all__ = ["main"]
