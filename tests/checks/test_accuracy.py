from __future__ import annotations

import math

import mpmath
import pytest
import torch

from nerfreg.checks.accuracy import relative_error


@pytest.mark.parametrize(
    ("values", "truth", "error"),
    [
        (1.5, 1.0, 0.5),
        (torch.tensor([[1.0, 2.0], [4.0, 4.0]]), [[1, 2], [mpmath.mpf(4), 5]], 0.2),
        (-1.0, 1.0, 2.0),
        (0.0, 0.0, 0.0),
        # 1e-38 is below the smallest normal number of float32: all such numbers are as good
        (1e-39, mpmath.mpf("1e-500"), 0.0),
        (0.0, 1e-38, 0.0),
        (1e-30, 0.0, math.inf),
        (math.inf, 1.0, math.inf),
        ([], [], 0.0),
    ],
)
def test_relative_error(values, truth, error):
    assert relative_error(values, truth, "float32") == pytest.approx(error, rel=1e-15)


def test_relative_error_of_nan_is_no_number():
    assert math.isnan(relative_error(torch.tensor([math.nan, 1.0]), [0.0, 1.0], "float32"))


def test_smallest_normal_number_depends_on_the_precision():
    assert relative_error(0.0, 1e-38, "float64") == 1


def test_other_number_of_values():
    with pytest.raises(ValueError, match="2 values, but 1 exact ones"):
        relative_error(torch.ones(2), [1.0], "float32")
