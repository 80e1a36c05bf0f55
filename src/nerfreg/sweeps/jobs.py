"""One job of a sweep: it is done, or skipped because it is complete, or fails alone."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba

from nerfreg.config.schema import Config
from nerfreg.runs.files import RESULTS
from nerfreg.sweeps.failures import in_one_line, write_failure
from nerfreg.sweeps.folders import BusyError, claimed, clear
from nerfreg.sweeps.journal import JobEntry, JobState, Journal
from nerfreg.sweeps.plan import OBJECTIVE, Plan

SCORES = ("psnr", "average")


@dataclass(frozen=True)
class Sweep:
    """What every job knows of its sweep.

    Attributes:
        plan: How many jobs there are, and how many run at once.
        journal: Where each job says what became of it.
        leaves: The file by which a complete job is known; None: jobs are always done again.
    """

    plan: Plan
    journal: Journal
    leaves: str | None

    def attempt(
        self,
        number: int,
        overrides: Sequence[str],
        folder: Path,
        compose: Callable[[], Config],
        job: Callable[[Config, Path], object],
    ) -> float | None:
        """Do a job, and write down what became of it.

        Nothing but an interruption leaves this method: an error is saved in the folder, and the
        sweep goes on.

        Args:
            number: The place in the order of the sweep, from 0.
            overrides: Those of this job.
            folder: Its run folder.
            compose: Returns its configuration, or raises.
            job: What to do.

        Returns:
            What a sweeper minimizes, where there is such a score.
        """
        report = _Report(self, number, self.plan.title(overrides), folder)
        report.tell(JobState.BEGUN)
        try:
            with claimed(folder):
                if self.leaves and (folder / self.leaves).is_file():
                    report.tell(JobState.SKIPPED, "complete")
                    return _objective(folder)
                report.say(report.title)
                if self.leaves:
                    clear(folder)
                self._run(report, compose(), job)
        except BusyError:
            report.tell(JobState.SKIPPED, "another process is at it")
            return None
        except (Exception, SystemExit) as error:
            # A plugin may raise anything, and may even call sys.exit.
            write_failure(folder, error, overrides)
            report.tell(JobState.FAILED, in_one_line(error))
            return None
        report.tell(JobState.DONE)
        return _objective(folder)

    def _run(self, report: _Report, config: Config, job: Callable[[Config, Path], object]) -> None:
        if not self.plan.parallel:
            job(config, report.folder)
            return
        # Progress bars of several processes would draw over each other, and lines of several jobs
        # would mix. So bars are off, and what a job prints is held back and marked with its number.
        threads = config.train.threads or _fair_threads(self.plan)
        config.train = dataclasses.replace(config.train, quiet=True, threads=threads)
        with redirect_stdout(io.StringIO()) as said:
            job(config, report.folder)
        for line in said.getvalue().splitlines():
            report.say(line)


@dataclass(frozen=True)
class _Report:
    """Tells the user and the journal of one job."""

    sweep: Sweep
    number: int
    title: str
    folder: Path

    def say(self, line: str) -> None:
        sys.stderr.write(f"[{self.number + 1}/{self.sweep.plan.jobs}] {line}\n")
        sys.stderr.flush()

    def tell(self, state: JobState, reason: str = "") -> None:
        complete = state in (JobState.DONE, JobState.SKIPPED)
        results = _results(self.folder) if complete else {}
        scores = {name: results[name] for name in SCORES if name in results}
        entry = JobEntry(self.number, self.title, state, str(self.folder), scores, reason)
        self.sweep.journal.write(entry)
        if reason:
            failed = state is JobState.FAILED
            self.say(f"{state}: {reason}" if failed else f"{self.title}: {state}, {reason}")


def _objective(folder: Path) -> float | None:
    """Return what a sweeper may minimize: never a score of test views."""
    results = _results(folder)
    return results.get(OBJECTIVE) if results.get("held_out") else None


def _results(folder: Path) -> Mapping[str, Any]:
    try:
        results = json.loads((folder / RESULTS).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    assert isinstance(results, dict)
    return results


def _fair_threads(plan: Plan) -> int:
    """Return the share of a job in this machine, or what the launcher gives its processes."""
    # Not torch's number, which a job before this one in the same process has changed.
    given = int(numba.config.NUMBA_NUM_THREADS)
    if plan.at_once is None:
        return given
    return max(1, min(given, (os.cpu_count() or 1) // plan.at_once))
