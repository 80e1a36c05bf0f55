"""The Pareto front, on points whose front is seen at a glance."""

from __future__ import annotations

import math

import pytest

from nerfreg.analysis.pareto import front


def test_points_that_another_beats_in_both_are_not_on_the_front() -> None:
    #  error
    #    4 | 0 . . .
    #    3 | . 1 2 .      2 is slower than 1 and no better;
    #    2 | . . . 3      3 is as fast as 4 and worse
    #    1 | . . . 4
    #        1 2 3 4 seconds
    assert front([(1.0, 4.0), (2.0, 3.0), (3.0, 3.0), (4.0, 2.0), (4.0, 1.0)]) == [0, 1, 4]


def test_the_front_is_in_the_order_of_time_wherever_its_points_stood() -> None:
    assert front([(4.0, 1.0), (1.0, 4.0), (2.0, 2.0)]) == [1, 2, 0]


def test_equal_points_do_not_dominate_each_other() -> None:
    assert front([(2.0, 1.0), (1.0, 3.0), (2.0, 1.0)]) == [1, 0, 2]


def test_what_is_as_good_but_slower_is_dominated() -> None:
    assert front([(2.0, 1.0), (1.0, 1.0)]) == [1]


@pytest.mark.parametrize(
    "unknown", [(None, 0.0), (0.0, None), (None, None), (0.0, math.nan), (math.inf, 0.0)]
)
def test_what_is_unknown_neither_is_on_the_front_nor_dominates(
    unknown: tuple[float | None, float | None],
) -> None:
    assert front([unknown, (1.0, 1.0)]) == [1]
    assert front([unknown]) == []


def test_of_no_point_the_front_is_empty_and_of_one_it_is_that() -> None:
    assert front([]) == []
    assert front([(5.0, 5.0)]) == [0]


def test_nothing_dominates_a_point_of_the_front_and_something_dominates_every_other() -> None:
    # a lattice in which (i * 7) % 11 scrambles the order; checked against the definition
    points = [(float(i % 5), float((i * 7) % 11)) for i in range(40)]
    chosen = front(points)
    for index, (x, y) in enumerate(points):
        dominated = any(a <= x and b <= y and (a, b) != (x, y) for a, b in points)
        assert (index in chosen) != dominated
