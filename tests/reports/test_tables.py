"""Means and deviations by hand, and marks."""

from __future__ import annotations

import math
from dataclasses import astuple

import pytest

from nerfreg.reports.tables import Column, Row, TableCell, marked, mean_of, mean_over_scenes


def test_sample_standard_deviation() -> None:
    # 1, 2, 6: mean 3, squares 4 + 1 + 9 = 14 over n - 1 = 2
    found = mean_of([1.0, None, 2.0, 6.0])
    assert astuple(found)[:3] == pytest.approx((3.0, math.sqrt(7), 3))
    assert mean_of([4.0, None]) == TableCell(4.0, None, 1)
    assert mean_of([None]) == mean_of([]) == TableCell()


def test_means_over_scenes_weigh_scenes_alike() -> None:
    # one scene with five seeds, one with two: (10 + 20) / 2; sqrt(0.3^2 + 0.4^2) / 2
    found = mean_over_scenes([TableCell(10.0, 0.3, 5), TableCell(20.0, 0.4, 2)])
    assert astuple(found)[:3] == pytest.approx((15.0, 0.25, 7))
    assert mean_over_scenes([TableCell(10.0, 0.3, 5), TableCell(20.0, None, 1)]) == TableCell(
        15.0, None, 6
    )
    assert mean_over_scenes([TableCell(10.0, 0.3, 5), TableCell()]) == TableCell()
    assert mean_over_scenes([]) == TableCell()


def marks(column: Column, *values: float | None) -> str:
    rows = marked(
        (column,), [Row(str(index), (TableCell(value),)) for index, value in enumerate(values)]
    )
    return "".join(
        "b" if row.cells[0].best else "s" if row.cells[0].second else "-" for row in rows
    )


def test_marks() -> None:
    up, down, neither = (
        Column("", "", ".1f", "up"),
        Column("", "", ".1f", "down"),
        Column("", "", ".1f"),
    )
    assert marks(up, 1.0, 3.0, 2.0) == "-bs"
    assert marks(down, 1.0, 3.0, 2.0) == "b-s"
    assert marks(up, 3.04, 2.96, 2.0, None) == "bbs-"  # alike in print
    assert marks(up, 3.0, 2.0, 2.0, 1.0) == "bss-"
    assert marks(up, 3.0, 3.01) == "--"
    assert marks(up, 3.0) == "-" and marks(up, None, 3.0) == "--"
    assert marks(neither, 1.0, 2.0) == "--"
