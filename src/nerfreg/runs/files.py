"""The files in a run's folder, by name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nerfreg.files import append_json_line, write_json

METRICS = "metrics.jsonl"
"""One line for each evaluation."""
RESULTS = "results.json"
"""The last evaluation, and what the run was."""
RENDERS = "renders"
"""Folder of the pictures of test views."""
RECORDED_STEPS = "nonfinite"
"""Folder of the steps that were left out because they were not finite."""
FAILED = "failed.json"
"""Why a job of a sweep has no results."""


def append_metrics(folder: Path, record: Mapping[str, Any]) -> None:
    """Add one line to `metrics.jsonl`."""
    append_json_line(folder / METRICS, record)


def write_results(folder: Path, record: Mapping[str, Any]) -> None:
    """Write `results.json`, whole or not at all."""
    write_json(folder / RESULTS, record)
