"""Means and deviations, by hand; which of several runs of one seed counts."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import astuple
from pathlib import Path

import pytest

from nerfreg.reports.collect import collect
from nerfreg.reports.grouping import Setting
from nerfreg.reports.statistics import (
    Statistic,
    mean_of_means,
    ordered_methods,
    summarize,
    without_repetitions,
)


def test_sample_standard_deviation() -> None:
    # 1, 2, 6: mean 3, squares 4 + 1 + 9 = 14 over n - 1 = 2
    found = summarize([1.0, None, 2.0, 6.0])
    assert found is not None and astuple(found) == pytest.approx((3.0, math.sqrt(7), 3))
    assert summarize([4.0, None]) == Statistic(4.0, None, 1)
    assert summarize([None]) is None and summarize([]) is None


def test_means_over_scenes_weigh_scenes_alike() -> None:
    # one scene with five seeds, one with two: (10 + 20) / 2; sqrt(0.3^2 + 0.4^2) / 2
    found = mean_of_means([Statistic(10.0, 0.3, 5), Statistic(20.0, 0.4, 2)])
    assert found is not None and astuple(found) == pytest.approx((15.0, 0.25, 7))
    assert mean_of_means([Statistic(10.0, 0.3, 5), Statistic(20.0, None, 1)]) == Statistic(
        15.0, None, 6
    )
    assert mean_of_means([Statistic(10.0, 0.3, 5), None]) is None
    assert mean_of_means([]) is None


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
    assert [*ordered_methods(collect([tmp_path]), "vanilla")] == [
        "vanilla",
        "vanilla, sampler=x",
        "b",
        "a",
    ]
