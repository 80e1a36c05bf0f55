"""Which of several runs of one seed counts, and the order of methods."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from nerfreg.reports.collect import collect
from nerfreg.reports.records import Setting, by_method, without_repetitions


def test_the_last_complete_run_of_a_seed_counts(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    old, new = write_run("z_old"), write_run("a_new", evaluations=((1.0, 2.0), (100.0, 30.0)))
    going_on = write_run("going_on", evaluations=((200.0, 3.0),), complete=False)
    other = write_run("other", seed=1)
    failed = write_run("failed", evaluations=(), complete=False)
    (failed / "failed.json").write_text('{"error": "no"}')
    os.utime(old / "results.json", (1000, 1000))
    os.utime(new / "results.json", (2000, 2000))
    kept, notes = without_repetitions(collect([tmp_path]))
    assert [run.folder for run in kept] == [
        new,
        failed,
        other,
    ]  # one that failed is still to be told
    (lines,) = notes.values()
    assert list(notes) == [Setting("fern", 3, False)]
    assert [line.split(": ")[1] for line in lines] == [
        f"{new} counts, {going_on} does not.",
        f"{new} counts, {old} does not.",
    ]
    assert all("vanilla, seed 0, was run more than once" in line for line in lines)


def test_of_incomplete_runs_the_furthest_counts(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    far = write_run("far", evaluations=((5.0, 1.0), (9.0, 2.0)), complete=False)
    write_run("near", evaluations=((8.0, 2.0),), complete=False)
    write_run("start", evaluations=(), complete=False)
    kept, notes = without_repetitions(collect([tmp_path]))
    assert [run.folder for run in kept] == [far] and len(notes[Setting("fern", 3, False)]) == 2


def test_vanilla_stands_first(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("0", ["+reg=b"])
    write_run("1", ["+reg=a"])
    write_run("2", ["sampler=x"])
    write_run("3")
    assert [*by_method(collect([tmp_path]))] == [
        "vanilla",
        "vanilla, sampler=x",
        "b",
        "a",
    ]
