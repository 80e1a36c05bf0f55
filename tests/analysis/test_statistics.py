from __future__ import annotations

import math

import pytest

from nerfreg.analysis.statistics import (
    MOST_CELLS,
    Spread,
    cells_needed,
    error_of_look,
    interval,
    spread,
    student_quantile,
)


@pytest.mark.parametrize(
    ("error", "freedom", "t"),
    [  # two-sided values of printed tables of Student's t
        (0.05, 1, 12.706),
        (0.05, 2, 4.303),
        (0.05, 5, 2.571),
        (0.05, 30, 2.042),
        (0.01, 9, 3.250),
        (0.001, 3, 12.924),
        (0.2, 10, 1.372),
    ],
)
def test_quantiles_are_those_of_the_tables(error: float, freedom: int, t: float) -> None:
    assert student_quantile(error, freedom) == pytest.approx(t, abs=6e-4)


def test_quantiles_of_one_and_two_degrees_have_a_closed_form() -> None:
    # P(|T| <= t) = (2 / pi) atan(t) with one degree of freedom, t / sqrt(2 + t^2) with two.
    for error in (0.3, 0.05, 1e-4):
        assert student_quantile(error, 1) == pytest.approx(
            math.tan(math.pi / 2 * (1 - error)), rel=1e-6
        )
        inside = 1 - error
        assert student_quantile(error, 2) == pytest.approx(
            inside * math.sqrt(2 / (1 - inside**2)), rel=1e-6
        )


def test_an_interval_by_hand() -> None:
    # mean 2.5; deviation sqrt(5 / 3) = 1.29099; half = 3.18245 * 1.29099 / sqrt(4) = 2.05426
    found = interval([1.0, 2.0, 3.0, 4.0], 0.05)
    assert (found.mean, found.count) == (2.5, 4)
    assert found.deviation == pytest.approx(1.29099, abs=1e-5)
    assert (found.low, found.high) == (
        pytest.approx(0.44574, abs=1e-4),
        pytest.approx(4.55426, abs=1e-4),
    )


def test_too_few_differences_say_nothing() -> None:
    one, none = interval([0.7], 0.05), interval([], 0.05)
    assert (one.mean, one.low, one.high, one.count) == (0.7, -math.inf, math.inf, 1)
    assert math.isnan(none.mean) and (none.low, none.high, none.count) == (-math.inf, math.inf, 0)
    assert not one.inside(100.0) and not none.inside(100.0)


def test_no_spread_is_a_point() -> None:
    same = interval([0.25, 0.25], 0.05)
    assert (same.low, same.high, same.deviation) == (0.25, 0.25, 0.0)
    assert same.inside(0.25) and not same.inside(0.2)


def test_the_errors_of_all_looks_add_up_to_the_whole() -> None:
    # sum over k = 1..n of 1 / (k (k + 1)) is 1 - 1 / (n + 1)
    assert sum(error_of_look(look, 1) for look in range(1, 100)) == pytest.approx(0.05 * 0.99)
    assert error_of_look(1, 1) == pytest.approx(0.025)
    assert error_of_look(2, 6) == pytest.approx(0.05 / 6 / 6)


def test_cells_needed() -> None:
    # Deviation 1, half 1: t(n - 1) <= sqrt(n).
    # 2.571 > sqrt(6) = 2.449, but 2.447 < sqrt(7) = 2.646.
    assert cells_needed(1.0, 1.0, 0.05) == 7
    # Much more than it needs: two are the fewest.
    assert cells_needed(1e-6, 1.0, 0.05) == 2
    assert cells_needed(0.0, 1.0, 0.05) == 2
    # (1.96 / 0.01)^2 = 38416
    assert MOST_CELLS < 38416 and cells_needed(1.0, 0.01, 0.05) is None
    assert cells_needed(1.0, 0.0, 0.05) is None
    assert cells_needed(math.nan, 1.0, 0.05) is None


def test_spread_of_eleven_values() -> None:
    # 0 to 10: the quantile q lies at 10 q.
    assert spread([float(n) for n in reversed(range(11))]) == Spread(5.0, 1.0, 9.0)
    assert spread([4.0]) == Spread(4.0, 4.0, 4.0)
