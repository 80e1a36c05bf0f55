"""`failed.json`: why a run of a sweep has no results."""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from nerfreg.files import write_json
from nerfreg.runs.files import FAILED


def write_failure(folder: Path, error: BaseException, overrides: Sequence[str]) -> None:
    """Save the error's class, message and traceback, the overrides of the job, and the time.

    Raises:
        NerfregError: The file cannot be written.
    """
    record = {
        "error": type(error).__name__,
        "message": str(error),
        "overrides": [*overrides],
        "traceback": "".join(traceback.format_exception(error)),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    write_json(folder / FAILED, record)


def in_one_line(error: BaseException) -> str:
    """Return the class and message of an error on one line."""
    return " ".join(f"{type(error).__name__}: {error}".split()).rstrip(": ")
