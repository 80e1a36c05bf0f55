"""Seconds to a PSNR, and seconds per step."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nerfreg.reports.collect import collect
from nerfreg.reports.tables import Row
from nerfreg.reports.timing import Crossing, cost_tables, seconds_to_psnr
from nerfreg.runs.records import EvaluationRecord


def evaluations(*points: tuple[float, float | None]) -> list[EvaluationRecord]:
    return [
        EvaluationRecord(1, seconds, psnr, None, None, None, None, 2, False)
        for seconds, psnr in points
    ]


def seconds(curve: list[EvaluationRecord], psnr: float) -> float:
    crossing = seconds_to_psnr(curve, psnr)
    assert crossing is not None and not crossing.at_most
    return crossing.seconds


def test_halfway_in_psnr_is_halfway_in_the_logarithm_of_time() -> None:
    curve = evaluations((10.0, 15.0), (1000.0, 20.0))
    assert seconds(curve, 17.5) == pytest.approx(100.0)
    # a quarter of the way: 10 * 100^(1/4)
    assert seconds(curve, 16.25) == pytest.approx(10 * math.sqrt(10))
    assert seconds(curve, 20.0) == pytest.approx(1000.0)


def test_the_first_crossing_counts() -> None:
    curve = evaluations((1.0, 10.0), (4.0, 20.0), (8.0, 12.0), (16.0, 30.0))
    assert seconds(curve, 15.0) == pytest.approx(2.0)


def test_between_the_neighbours_of_the_crossing() -> None:
    curve = evaluations((1.0, 19.0), (2.0, 10.0), (8.0, 20.0))
    assert seconds(curve, 19.5) == pytest.approx(2 * 4**0.95)


def test_above_from_the_start_and_never() -> None:
    curve = evaluations((10.0, 15.0), (1000.0, 20.0))
    assert seconds_to_psnr(curve, 15.0) == Crossing(10.0, at_most=True)
    assert seconds_to_psnr(curve, 20.01) is None
    assert seconds_to_psnr([], 1.0) is None


def test_evaluations_without_psnr_or_time_are_passed_over() -> None:
    curve = evaluations((0.0, 18.0), (10.0, 15.0), (50.0, None), (1000.0, 20.0))
    assert seconds(curve, 17.5) == pytest.approx(100.0)


def cost_rows(folder: Path) -> dict[str, Row]:
    return {row.label: row for table in cost_tables(collect([folder])) for row in table.rows}


def train(threads: int = 1, **keys: Any) -> dict[str, Any]:
    return {"train": {"steps": None, "seconds": 100.0, "threads": threads, **keys}}


def test_cost_is_relative_to_vanilla_under_the_same_conditions(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    def run(name: str, seconds: float, reg: str | None, seed: int = 0, **config: Any) -> None:
        overrides = [f"+reg={reg}"] if reg else []
        regularizers = {reg: {"weight": 1.0}} if reg else {}
        whole = {**train(), **config, "reg": regularizers}
        write_run(
            name,
            overrides,
            ((seconds, 20.0),),
            seed,
            config=whole,
            step=1000,
            regularizers=regularizers,
        )

    # 1000 steps each, so seconds are milliseconds per step
    for seed, seconds in enumerate((10.0, 11.0, 30.0)):
        run(f"vanilla{seed}", seconds, None, seed)
    run("kl", 22.0, "kl")
    run("steps", 33.0, "lipschitz", **train(steps=1000, seconds=None))
    for line in (tmp_path).glob("*/metrics.jsonl"):
        line.unlink()  # results.json says it all
    # budgets differ, so they are named
    found = cost_rows(tmp_path)
    # the median of 10, 11 and 30 ms
    vanilla, kl = found["vanilla, 100 s"], found["kl, 100 s"]
    assert [cell.value for cell in vanilla.cells] == pytest.approx([11.0, 1.0])
    assert vanilla.count == 3
    assert [cell.value for cell in kl.cells] == pytest.approx([22.0, 2.0])
    # vanilla was given seconds
    assert found["lipschitz, 1000 steps"].cells[1].value is None


def test_cost_with_other_threads_or_settings_has_no_relation(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    write_run("a")
    write_run("b", ["+reg=kl"], config={**train(2), "reg": {"kl": {"weight": 1.0}}}, threads=2)
    write_run(
        "c",
        ["+reg=lipschitz", "train.rays=2"],
        config={**train(rays=2), "reg": {"lipschitz": {"weight": 1.0}}},
    )
    relative = {label: row.cells[1].value for label, row in cost_rows(tmp_path).items()}
    assert relative == {
        "vanilla, 1 thread": 1.0,
        "kl, 2 threads": None,
        "lipschitz, train.rays=2, 1 thread": None,
    }


def test_the_cost_of_runs_that_go_on_is_known_and_of_failed_ones_is_not(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    write_run("a", evaluations=((20.0, 5.0),), complete=False)
    (write_run("b", ["sampler=x"]) / "failed.json").write_text("{}")
    write_run("c", ["sampler=y"], evaluations=(), complete=False)
    write_run("d", ["sampler=z"])
    # 10 steps a second
    costs = {label: row.cells[0].value for label, row in cost_rows(tmp_path).items()}
    assert costs == {"vanilla": pytest.approx(100.0), "vanilla, sampler=z": pytest.approx(100.0)}


def test_costs(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("a")
    write_run(
        "b",
        ["+reg=kl"],
        evaluations=((10.0, 15.0), (100.0, 20.0)),
        config={"reg": {"kl": {"weight": 1.0}}},
    )
    (table,) = cost_tables(collect([tmp_path]))
    # conftest.py: ten steps a second
    assert [(row.label, row.cells[0].value, row.cells[1].value) for row in table.rows] == [
        ("vanilla", pytest.approx(100.0), pytest.approx(1.0)),
        ("kl", pytest.approx(100.0), pytest.approx(1.0)),
    ]
    assert "Trained with 1 thread." in table.notes


def test_one_method_has_no_cost_to_compare(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("a")
    assert cost_tables(collect([tmp_path])) == []
