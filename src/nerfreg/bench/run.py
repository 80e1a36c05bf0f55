"""Run one bench by its name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from nerfreg.files import json_text


def run(
    name: str, folder: Path, sizes: Mapping[str, Any], words: Sequence[str] | None, *, quick: bool
) -> int:
    """Run a bench, print the files that it wrote and its record as JSON, and return the exit code.

    Args:
        name: A module of this package that has `run` and its sizes, `FULL` and `QUICK`.
        folder: Where its files go.
        sizes: Fields of its sizes that are chosen.
        words: Overrides, or the folder of a run; None for a bench that takes neither.
        quick: Whether the other sizes are the small ones, with which it ends within seconds.
    """
    # By name, so that a bench is imported only when it is run.
    bench: Any = import_module(f"nerfreg.bench.{name}")
    chosen = replace(bench.QUICK if quick else bench.FULL, **sizes)
    outcome = bench.run(folder, chosen, *([] if words is None else [tuple(words)]))
    for path in outcome.files:
        print(path)
    if outcome.record is not None:
        print(json_text(outcome.record))
    return 0
