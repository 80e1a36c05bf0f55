"""Real spherical harmonics of viewing directions."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

DEGREES = (0, *[1] * 3, *[2] * 5, *[3] * 7)
"""Degree of each harmonic."""

WIDTH = len(DEGREES)
"""Number of harmonics, those of degree below 4."""


def spherical_harmonics(directions: Float[Tensor, "*rays 3"]) -> Float[Tensor, "*rays 16"]:
    """Evaluate the orthonormal real spherical harmonics up to degree 3.

    Args:
        directions: Unit vectors.

    Returns:
        The harmonics, `(..., 16)`, ordered by degree l and then by order m from -l to l, with the
        signs of the Condon-Shortley phase.
    """
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    # Written out as polynomials: on the unit sphere they are exact and need no angles, whose
    # gradients would be singular at the poles. Each factor is the normalization constant
    # sqrt((2l+1)/(4 pi) (l-m)!/(l+m)!), times sqrt(2) for m != 0.
    return torch.stack(
        [
            torch.full_like(x, 0.28209479177387814),
            -0.48860251190291987 * y,
            0.48860251190291987 * z,
            -0.48860251190291987 * x,
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (3 * zz - 1),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (5 * zz - 1),
            0.3731763325901154 * z * (5 * zz - 3),
            -0.4570457994644658 * x * (5 * zz - 1),
            1.445305721320277 * z * (xx - yy),
            -0.5900435899266435 * x * (xx - 3 * yy),
        ],
        dim=-1,
    )
