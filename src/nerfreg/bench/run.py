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
    """Run a bench, and print the files that it wrote and its record, if it has one, as JSON.

    A bench is a module of this package with sizes, the dataclasses `FULL` and `QUICK`, of which the
    second makes it end within seconds, and a function `run` that returns a `BenchOutcome`.

    Args:
        name: Of the module.
        folder: Where its files go.
        sizes: Fields of its sizes that are chosen.
        words: Overrides, or the folder of a run; None for a bench that takes neither.
        quick: Whether the other sizes are the small ones.

    Returns:
        The exit code, 0.
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
