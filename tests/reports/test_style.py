"""Styles, ticks and labels of the figures."""

from __future__ import annotations

from pathlib import Path

import pytest

from nerfreg.reports.axes import duration, separate, shortened, time_ticks
from nerfreg.reports.records import Evaluation, RunRecord
from nerfreg.reports.style import COLORED, method_styles


def run(method: str, psnr: float | None) -> RunRecord:
    final = None if psnr is None else Evaluation(100, 60.0, psnr, None, None, None, None, 3, True)
    return RunRecord(Path(method), method, "fern", 3, 0, False, (), final, None, None, {}, ())


def test_places_that_are_far_enough_apart_stay() -> None:
    assert separate([3.0, 1.0, 2.0], 1.0) == [3.0, 1.0, 2.0]


def test_places_too_close_move_apart_by_as_much_on_both_sides() -> None:
    # 1.0 and 1.2 have the middle 1.1; with a gap of 1 that is 0.6 and 1.6
    assert separate([1.2, 1.0, 9.0], 1.0) == pytest.approx([1.6, 0.6, 9.0])


def test_a_crowd_that_grows_into_its_neighbour_takes_it_in() -> None:
    # 0, 0.1 -> -0.45, 0.55, too near to 1.2: the middle of all three is 1.3 / 3, and they stand 1 apart
    assert separate([0.0, 0.1, 1.2], 1.0) == pytest.approx([1.3 / 3 - 1, 1.3 / 3, 1.3 / 3 + 1])


def test_equal_places_keep_their_order() -> None:
    assert separate([5.0, 5.0], 2.0) == [4.0, 6.0]
    assert separate([], 1.0) == []


def test_long_names_lose_their_middle() -> None:
    assert shortened("short", 5) == "short"
    assert shortened("abcdefghij", 5) == "ab…ij"
    assert len(shortened("x" * 100, 24)) == 24


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


def test_the_best_methods_and_vanilla_have_a_colour_of_their_own() -> None:
    # two more than there are colours: of m0 < m1 < ... < m10 the worst two are grey, vanilla, worse still, is not
    runs = [run(f"m{index}", 20.0 + index) for index in range(COLORED)] + [
        run("unscored", None),
        run("vanilla", 1.0),
    ]
    styles = method_styles(runs)
    assert {method for method, style in styles.items() if style.faint} == {"m0", "unscored"}
    coloured = [style for style in styles.values() if not style.faint]
    assert len({(style.color, str(style.dash)) for style in coloured}) == COLORED
    assert len({style.marker for style in coloured}) == COLORED
