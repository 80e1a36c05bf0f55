"""Error and cost against run time of what nerfreg computes: `nerfreg bench`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class BenchOutcome:
    """The files that a bench wrote, and a JSON object to print in one line, if there is one."""

    files: list[Path]
    record: dict[str, Any] | None = None
