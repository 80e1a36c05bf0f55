"""Ticks and legends of the figures."""

from __future__ import annotations

import pytest

from nerfreg.reports.axes import duration, legend_columns, time_ticks


def test_ticks_are_round_times_and_not_too_many() -> None:
    assert time_ticks(9.0, 700.0, 6) == [10.0, 20.0, 30.0, 60.0, 120.0, 300.0, 600.0][::-2][::-1]
    assert time_ticks(95.0, 130.0, 6) == [105.0, 120.0]
    assert time_ticks(61.0, 62.0, 6) == [61.0]  # the geometric mean, to two digits
    assert len(time_ticks(1.0, 86400.0, 4)) <= 4


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.5, "0.5 s"), (59.4, "59.4 s"), (60.0, "1 min"), (90.0, "1.5 min"), (5400.0, "1.5 h")],
)
def test_durations_as_they_are_said(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_long_names_have_fewer_columns() -> None:
    # 6.9 inches are 497 points; a name of 20 characters takes about 130 of them, and one of 80
    # characters more than half
    assert legend_columns(["x" * 20] * 5) == 3
    assert legend_columns(["x" * 20, "x" * 80]) == 1
    assert legend_columns([]) == 3
