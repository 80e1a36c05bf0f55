"""What became of each job, told by the jobs themselves: they may run in other processes, and on other machines."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path

from nerfreg.files import write_json


class State(StrEnum):
    """begun: and not heard of since."""

    BEGUN = "begun"
    DONE = "done"
    SKIPPED = "skipped"
    FAILED = "failed"


@dataclass(frozen=True)
class Entry:
    """One job. number: in the order of the sweep, from 0. title: what distinguishes it from the others.

    reason: why it was skipped or failed.
    scores: `psnr` and the like of `results.json`, None where unknown; empty unless it is there.
    """

    number: int
    title: str
    state: State
    folder: str
    scores: Mapping[str, float | None]
    reason: str = ""


@dataclass(frozen=True)
class Journal:
    """A folder that all jobs of a sweep can write to, one file each."""

    folder: Path

    def write(self, entry: Entry) -> None:
        """Tell of a job, instead of what was told before."""
        write_json(self.folder / f"{entry.number}.json", asdict(entry))

    def read(self) -> list[Entry]:
        """The latest of each job, in the order of their numbers."""
        records = [
            json.loads(path.read_text(encoding="utf-8")) for path in self.folder.glob("[0-9]*.json")
        ]
        entries = [Entry(**{**record, "state": State(record["state"])}) for record in records]
        return sorted(entries, key=lambda entry: entry.number)

    def remove(self) -> None:
        """Nobody will ask again."""
        shutil.rmtree(self.folder, ignore_errors=True)
        with suppress(OSError):  # of another sweep that is still at it
            self.folder.parent.rmdir()
