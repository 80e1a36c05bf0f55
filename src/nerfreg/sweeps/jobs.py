"""One job of a sweep: done, skipped because it was complete, or failed for itself."""

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

from nerfreg.config.schema import Config
from nerfreg.runs.files import RESULTS
from nerfreg.sweeps.failures import in_one_line, write_failure
from nerfreg.sweeps.folders import BusyError, claimed, clear
from nerfreg.sweeps.journal import Entry, Journal, State
from nerfreg.sweeps.plan import OBJECTIVE, Plan

SCORES = ("psnr", "average")


@dataclass(frozen=True)
class Sweep:
    """What every job of a sweep knows of it.

    leaves: the file by which a complete job is known; None: jobs are done again whenever they are asked for.
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
        """Do a job, and tell the journal what became of it; returns the objective where there is one.

        Nothing but an interruption comes out of it: an error is saved in the folder, and the sweep goes on.
        """
        report = _Report(self, number, self.plan.title(overrides), folder)
        report.tell(State.BEGUN)
        try:
            with claimed(folder):
                if self.leaves and (folder / self.leaves).is_file():
                    report.tell(State.SKIPPED, "complete")
                    return _objective(folder)
                report.say(report.title)
                if self.leaves:
                    clear(folder)
                self._run(report, compose(), job)
        except BusyError:
            report.tell(State.SKIPPED, "another process is at it")
            return None
        except (Exception, SystemExit) as error:  # a plugin may raise anything
            write_failure(folder, error, overrides)
            report.tell(State.FAILED, in_one_line(error))
            return None
        report.tell(State.DONE)
        return _objective(folder)

    def _run(self, report: _Report, config: Config, job: Callable[[Config, Path], object]) -> None:
        if not self.plan.parallel:
            job(config, report.folder)
            return
        # bars of several processes would draw over each other, and lines of several jobs would mix
        threads = config.train.threads or _fair_threads(self.plan)
        config.train = dataclasses.replace(config.train, quiet=True, threads=threads)
        with redirect_stdout(io.StringIO()) as said:
            job(config, report.folder)
        for line in said.getvalue().splitlines():
            report.say(line)


@dataclass(frozen=True)
class _Report:
    """Tells of one job: to whoever watches, and to the journal."""

    sweep: Sweep
    number: int
    title: str
    folder: Path

    def say(self, line: str) -> None:
        sys.stderr.write(f"[{self.number + 1}/{self.sweep.plan.jobs}] {line}\n")
        sys.stderr.flush()

    def tell(self, state: State, reason: str = "") -> None:
        results = _results(self.folder) if state in (State.DONE, State.SKIPPED) else {}
        scores = {name: results[name] for name in SCORES if name in results}
        self.sweep.journal.write(
            Entry(self.number, self.title, state, str(self.folder), scores, reason)
        )
        if reason:
            self.say(
                f"{state}: {reason}"
                if state is State.FAILED
                else f"{self.title}: {state}, {reason}"
            )


def _objective(folder: Path) -> float | None:
    """What a sweeper may minimize: never a score of test views."""
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
    """Threads for one of several jobs: its share of this machine, or what the launcher gives its processes."""
    import numba

    # Not torch's number: a job before this one in the same process has changed it.
    given = int(numba.config.NUMBA_NUM_THREADS)
    return (
        given if plan.at_once is None else max(1, min(given, (os.cpu_count() or 1) // plan.at_once))
    )
