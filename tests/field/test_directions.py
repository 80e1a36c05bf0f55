"""Spherical harmonics against their defining properties."""

from __future__ import annotations

import math

import torch
from torch.nn import functional

from nerfreg.field.directions import spherical_harmonics


def test_values_at_the_pole() -> None:
    # At the north pole all harmonics of order m != 0 vanish, and Y_l0 = sqrt((2l + 1) / 4 pi).
    expected = torch.zeros(16)
    for degree, index in enumerate((0, 2, 6, 12)):
        expected[index] = math.sqrt((2 * degree + 1) / (4 * math.pi))
    torch.testing.assert_close(spherical_harmonics(torch.tensor([0.0, 0.0, 1.0])), expected)


def test_orthonormal_on_the_sphere() -> None:
    # Gauss-Legendre in z times equal steps in azimuth integrates polynomials of degree 6 exactly.
    import numpy as np

    nodes, weights = np.polynomial.legendre.leggauss(8)
    azimuth = torch.arange(16, dtype=torch.float64) * (2 * math.pi / 16)
    z = torch.tensor(nodes)[:, None].expand(8, 16)
    rim = torch.sqrt(1 - z * z)
    directions = torch.stack(
        [rim * torch.cos(azimuth), rim * torch.sin(azimuth), z], dim=-1
    ).reshape(-1, 3)
    measure = torch.tensor(weights)[:, None].expand(8, 16).reshape(-1) * (2 * math.pi / 16)
    harmonics = spherical_harmonics(directions)
    gram = torch.einsum("pi,pj,p->ij", harmonics, harmonics, measure)
    torch.testing.assert_close(gram, torch.eye(16, dtype=torch.float64), rtol=0, atol=1e-12)


def test_addition_theorem() -> None:
    # sum over m of Y_lm^2 is (2l + 1) / 4 pi in every direction
    directions = functional.normalize(torch.randn(20, 3, dtype=torch.float64), dim=-1)
    squares = spherical_harmonics(directions).square()
    for degree, (first, last) in enumerate(((0, 1), (1, 4), (4, 9), (9, 16))):
        expected = torch.full((20,), (2 * degree + 1) / (4 * math.pi), dtype=torch.float64)
        torch.testing.assert_close(squares[:, first:last].sum(dim=1), expected)
