"""Names of the files and folders in a run's folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nerfreg.files import append_json_line, write_json

METRICS = "metrics.jsonl"
"""One line for each evaluation, in JSON."""
RESULTS = "results.json"
"""The last evaluation, and a description of the run."""
RENDERS = "renders"
"""Folder with pictures of test views."""
RECORDED_STEPS = "nonfinite"
"""Folder of the steps that training left out because they were not finite."""
FAILED = "failed.json"
"""Why a job of a sweep has no results."""


def append_metrics(folder: Path, record: Mapping[str, Any]) -> None:
    """Add one line to `metrics.jsonl`."""
    append_json_line(folder / METRICS, record)


def write_results(folder: Path, record: Mapping[str, Any]) -> None:
    """Write `results.json`, whole or not at all."""
    write_json(folder / RESULTS, record)
