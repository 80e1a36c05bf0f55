from __future__ import annotations

import math

import mpmath
import pytest
import torch

from nerfreg.rendering.reference import composite_exactly


def test_composite_by_hand():
    """Two intervals of length 1 and thickness log 2: each takes half of what arrives."""
    half = math.log(2)
    sigma = torch.tensor([[half, half]], dtype=torch.float64)
    rgb = torch.tensor([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]], dtype=torch.float64)
    edges = torch.tensor([[2.0, 3.0, 4.0]], dtype=torch.float64)
    ray = composite_exactly(sigma, rgb, edges, torch.ones(1, 3).double())
    assert [float(w) for w in ray["weights"][0]] == pytest.approx([1 / 2, 1 / 4], rel=1e-15)
    assert [float(t) for t in ray["log_transmittance"][0]] == pytest.approx([0.0, -half], rel=1e-15)
    assert float(ray["opacity"][0]) == pytest.approx(3 / 4, rel=1e-15)
    # (2.5 / 2 + 3.5 / 4) / (3 / 4)
    assert float(ray["depth"][0]) == pytest.approx(2.125 / 0.75, rel=1e-15)
    # a quarter of the white background passes
    assert [float(c) for c in ray["rgb"][0]] == pytest.approx([3 / 4, 1 / 2, 1 / 4], rel=1e-15)


def test_empty_ray_has_the_depth_of_its_far_end():
    ray = composite_exactly(torch.zeros(1, 2), torch.ones(1, 2, 3), torch.tensor([[1.0, 2.0, 5.0]]))
    assert (ray["opacity"][0], ray["depth"][0], ray["rgb"][0]) == (0, 5, [0, 0, 0])
    assert ray["weights"][0] == [0, 0]


def test_digits_where_float64_has_none():
    """A thickness of 1e-30 weighs 1e-30 - 5e-61; behind one of 1000, exp(-1000) is left."""
    edges = torch.tensor([[0.0, 1.0, 2.0]], dtype=torch.float64)
    sigma = torch.tensor([[1e-30, 0.0], [1000.0, 1000.0]], dtype=torch.float64)
    colors = torch.ones(2, 2, 3).double()
    thin, thick = composite_exactly(sigma, colors, edges.expand(2, 3))["weights"]
    with mpmath.workdps(50):
        first = mpmath.mpf(1e-30)
        assert abs(first - first**2 / 2 - thin[0]) < mpmath.mpf(10) ** -75
        assert abs(mpmath.log(thick[1]) + 1000) < mpmath.mpf(10) ** -40
