"""What a sweep has done, printed at its end or when it is interrupted."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from nerfreg.sweeps.journal import JobEntry, JobState

COLUMNS = ("", "state", "psnr", "average", "job")
STYLES = {
    JobState.DONE: "green",
    JobState.SKIPPED: "dim",
    JobState.FAILED: "red",
    JobState.BEGUN: "yellow",
}
WORDS = {JobState.BEGUN: "interrupted"}


def print_summary(entries: Sequence[JobEntry], jobs: int) -> None:
    """Print the jobs, then what failed and why, then how many came to what.

    The jobs are a table on a terminal; elsewhere they are columns separated by tabs.

    Args:
        entries: The jobs that were begun.
        jobs: How many there were to do.
    """
    if entries and sys.stdout.isatty():
        table = Table(*COLUMNS, box=None, pad_edge=False)
        for entry in entries:
            table.add_row(*(Text(cell, STYLES[entry.state]) for cell in _row(entry)))
        Console().print(table)
    elif entries:
        print("\t".join((*COLUMNS, "folder")))
        for entry in entries:
            print("\t".join((*_row(entry), _shown(entry.folder))))
    for entry in entries:
        if entry.state is JobState.FAILED:
            print(f"{_shown(entry.folder)}: {entry.reason}")
    print(in_numbers(entries, jobs))


def in_numbers(entries: Sequence[JobEntry], jobs: int) -> str:
    """Return `4 jobs: 2 done, 1 skipped, 1 failed`."""
    counts = Counter(entry.state for entry in entries)
    parts = [
        f"{counts[state]} {WORDS.get(state, state)}"
        for state in (JobState.DONE, JobState.SKIPPED, JobState.FAILED)
    ]
    if counts[JobState.BEGUN]:
        parts.append(f"{counts[JobState.BEGUN]} {WORDS[JobState.BEGUN]}")
    if jobs > len(entries):
        parts.append(f"{jobs - len(entries)} not begun")
    return f"{jobs} {'job' if jobs == 1 else 'jobs'}: {', '.join(parts)}"


def _row(entry: JobEntry) -> tuple[str, ...]:
    psnr, average = entry.scores.get("psnr"), entry.scores.get("average")
    return (
        str(entry.number + 1),
        WORDS.get(entry.state, entry.state),
        "" if psnr is None else f"{psnr:.2f}",
        "" if average is None else f"{average:.4f}",
        entry.title,
    )


def _shown(folder: str) -> str:
    path = Path(folder)
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)
