"""What became of each job of a sweep.

The jobs write it themselves: they may run in other processes, and on other machines.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path

from nerfreg.files import write_json


class JobState(StrEnum):
    """How far a job has come; one that stays at BEGUN was interrupted."""

    BEGUN = "begun"
    DONE = "done"
    SKIPPED = "skipped"
    FAILED = "failed"


@dataclass(frozen=True)
class JobEntry:
    """What the journal knows of one job.

    Attributes:
        number: The place in the order of the sweep, from 0.
        title: What distinguishes the job from the others.
        state: How far it has come.
        folder: Where its run is.
        scores: `psnr` and `average` of its `results.json`, None where unknown; empty without
            that file.
        reason: Why it was skipped or failed.
    """

    number: int
    title: str
    state: JobState
    folder: str
    scores: Mapping[str, float | None]
    reason: str = ""


@dataclass(frozen=True)
class Journal:
    """A folder to which all jobs of a sweep can write, one file each."""

    folder: Path

    def write(self, entry: JobEntry) -> None:
        """Save the entry of a job in place of its last one.

        Raises:
            NerfregError: The file cannot be written.
        """
        write_json(self.folder / f"{entry.number}.json", asdict(entry))

    def read(self) -> list[JobEntry]:
        """Return the latest entry of each job, by number."""
        records = [
            json.loads(path.read_text(encoding="utf-8")) for path in self.folder.glob("[0-9]*.json")
        ]
        entries = [JobEntry(**{**record, "state": JobState(record["state"])}) for record in records]
        return sorted(entries, key=lambda entry: entry.number)

    def remove(self) -> None:
        """Delete the folder, and its parent if no other sweep writes there."""
        shutil.rmtree(self.folder, ignore_errors=True)
        with suppress(OSError):  # The parent holds the journal of another sweep.
            self.folder.parent.rmdir()
