"""What a run leaves behind: `metrics.jsonl`, one line per evaluation, and `results.json`, the last of them.

Both are strict JSON. What is unknown (None) and what is not finite (nan, inf) are written as null.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nerfreg.errors import NerfregError
from nerfreg.files import atomic

METRICS = "metrics.jsonl"
RESULTS = "results.json"
RENDERS = "renders"
"""Folder of the pictures of test views."""
FAILED = "failed.json"
"""Why a job of a sweep has no results."""


def append_metrics(folder: Path, record: Mapping[str, Any]) -> None:
    """Add one line to `metrics.jsonl`; it is on its way to the disk when this returns."""
    line = json.dumps(_finite(record), allow_nan=False) + "\n"
    path = folder / METRICS
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(line)
    except OSError as error:
        raise NerfregError(f"{path}: cannot be written ({error.strerror or error})") from error


def write_results(folder: Path, record: Mapping[str, Any]) -> None:
    """Write `results.json`, whole or not at all."""
    text = json.dumps(_finite(record), allow_nan=False, indent=2) + "\n"
    with atomic(folder / RESULTS) as part:
        part.write_text(text, encoding="utf-8")


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
