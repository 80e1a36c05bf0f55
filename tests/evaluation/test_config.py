from __future__ import annotations

import subprocess
import sys

import pytest

from nerfreg.errors import NerfregError
from nerfreg.evaluation import EvalConfig, evaluation_times, subset_of


def test_times_are_log_spaced_from_a_fiftieth_to_the_end():
    # three log-spaced values between 0.02 and 1: 0.02, sqrt(0.02 * 1) = 0.141421, 1
    assert evaluation_times(60.0, None, 3) == pytest.approx((0.02, 0.14142136, 1.0), rel=1e-6)


def test_chosen_times_replace_the_log_spaced_ones_and_the_end_is_always_one():
    assert EvalConfig(at=[0.3, 0.1]).times(600.0, None) == (0.1, 0.3, 1.0)
    assert EvalConfig(at=[]).times(600.0, None) == (1.0,)
    assert EvalConfig(count=1).times(600.0, None) == (1.0,)
    for wrong in ([0.0], [1.5]):
        with pytest.raises(NerfregError, match=r"eval\.at"):
            EvalConfig(at=wrong)


def test_times_of_one_evaluation_are_the_end():
    assert evaluation_times(60.0, 1000, 1) == (1.0,)


def test_times_of_a_step_budget_are_whole_steps_without_duplicates():
    # 10 steps; 0.02 0.053 0.141 0.376 1 round up to steps 1 1 2 4 10
    assert evaluation_times(None, 10, 5) == (0.1, 0.2, 0.4, 1.0)


@pytest.mark.parametrize("steps", [1, 7, 30, 999, 12000])
def test_every_time_is_reached_exactly_once_by_a_loop_over_steps(steps):
    times = list(evaluation_times(None, steps, 8))
    reached = [step for step in range(1, steps + 1) if step / steps in times]
    assert len(reached) == len(times)
    assert reached[-1] == steps


def test_subset_is_even_over_the_views_and_all_of_them_where_there_are_few():
    # the middles of two halves of ten views: positions 2 and 7
    assert subset_of(range(100, 110), 2) == (102, 107)
    assert subset_of([4, 8, 15], 3) == (4, 8, 15)
    assert subset_of([4, 8, 15], 9) == (4, 8, 15)
    assert len(set(subset_of(range(25), 24))) == 24


@pytest.mark.parametrize(
    ("key", "value"), [("count", 0), ("subset_size", 0), ("pixels_stride", 0), ("save_renders", -1)]
)
def test_numbers_that_mean_nothing_are_refused_by_key_and_value(key, value):
    with pytest.raises(NerfregError, match=rf"eval\.{key}={value}"):
        EvalConfig(**{key: value})


def test_zero_saved_renders_is_allowed():
    assert EvalConfig(save_renders=0).save_renders == 0


def test_the_configuration_can_be_read_without_torch():
    script = "import sys, nerfreg.evaluation; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script]).returncode == 0
