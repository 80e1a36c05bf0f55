from __future__ import annotations

import math

import mpmath
import pytest
import torch

from nerfreg.checks.exact import composite_exactly, relative_error


def test_composite_by_hand():
    """Two intervals of length 1 and thickness log 2: each takes half of what arrives."""
    half = math.log(2)
    sigma = torch.tensor([[half, half]], dtype=torch.float64)
    rgb = torch.tensor([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]], dtype=torch.float64)
    edges = torch.tensor([[2.0, 3.0, 4.0]], dtype=torch.float64)
    [ray] = composite_exactly(sigma, rgb, edges, torch.ones(1, 3).double())
    assert [float(w) for w in ray.weights] == pytest.approx([1 / 2, 1 / 4], rel=1e-15)
    assert [float(t) for t in ray.log_transmittance] == pytest.approx([0.0, -half], rel=1e-15)
    assert float(ray.opacity) == pytest.approx(3 / 4, rel=1e-15)
    # (2.5 / 2 + 3.5 / 4) / (3 / 4)
    assert float(ray.depth) == pytest.approx(2.125 / 0.75, rel=1e-15)
    # a quarter of the white background passes
    assert [float(c) for c in ray.rgb] == pytest.approx([3 / 4, 1 / 2, 1 / 4], rel=1e-15)


def test_empty_ray_has_the_depth_of_its_far_end():
    [ray] = composite_exactly(
        torch.zeros(1, 2), torch.ones(1, 2, 3), torch.tensor([[1.0, 2.0, 5.0]])
    )
    assert (ray.opacity, ray.depth, ray.rgb) == (0, 5, [0, 0, 0])
    assert ray.weights == [0, 0]


def test_digits_where_float64_has_none():
    """Weights of a ray of thickness 1e-30 are 1e-30 - 5e-61, and behind a thickness of 1000 there are exp(-1000)."""
    edges = torch.tensor([[0.0, 1.0, 2.0]], dtype=torch.float64)
    sigma = torch.tensor([[1e-30, 0.0], [1000.0, 1000.0]], dtype=torch.float64)
    thin, thick = composite_exactly(sigma, torch.ones(2, 2, 3).double(), edges.expand(2, 3))
    with mpmath.workdps(50):
        first = mpmath.mpf(1e-30)
        assert abs(first - first**2 / 2 - thin.weights[0]) < mpmath.mpf(10) ** -75
        assert abs(mpmath.log(thick.weights[1]) + 1000) < mpmath.mpf(10) ** -40


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
