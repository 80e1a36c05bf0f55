"""OpenCV's lens distortion of normalized image coordinates, and its inverse."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

NEWTON_STEPS = 8
"""Convergence is quadratic, so a few steps reach the precision of float32 for any usual lens. With
a fixed number the result of a point does not depend on the others in its batch."""


def distort(
    points: Float[Tensor, "points 2"], coefficients: Float[Tensor, "points 5"]
) -> Float[Tensor, "points 2"]:
    """Distort ideal pinhole points (the Brown-Conrady model, as OpenCV writes it).

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
    y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y

    Args:
        points: Points (x, y) at depth 1, with y down, `(P, 2)`.
        coefficients: k1, k2, p1, p2, k3, `(P, 5)`.

    Returns:
        Where the lens shows the points, `(P, 2)`.
    """
    x, y = points.unbind(-1)
    k1, k2, p1, p2, k3 = coefficients.unbind(-1)
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return torch.stack((xd, yd), -1)


def undistort(
    points: Float[Tensor, "points 2"], coefficients: Float[Tensor, "points 5"]
) -> Float[Tensor, "points 2"]:
    """Invert `distort` by Newton's method, starting at the distorted point.

    Where the lens folds the image over itself there is no inverse. The result is then finite and
    wrong, and `invertible` says so.

    Args:
        points: Distorted points (x, y), `(P, 2)`.
        coefficients: k1, k2, p1, p2, k3, `(P, 5)`.

    Returns:
        The ideal pinhole points, `(P, 2)`.
    """
    k1, k2, p1, p2, k3 = coefficients.unbind(-1)
    solution = points
    for _ in range(NEWTON_STEPS):
        x, y = solution.unbind(-1)
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        # The derivative of `radial` by r^2, and the Jacobian of `distort`, which is symmetric.
        slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)
        dxx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        dyy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        dxy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        determinant = dxx * dyy - dxy * dxy
        # At a fold the determinant is 0 and the step infinite; a floor, and a bound on the step,
        # keep the iteration finite. Usual lenses never come near either.
        determinant = torch.where(determinant.abs() < 1e-2, 1e-2, determinant)
        ex, ey = (distort(solution, coefficients) - points).unbind(-1)
        step = torch.stack((dyy * ex - dxy * ey, dxx * ey - dxy * ex), -1) / determinant[:, None]
        solution = solution - step.clamp(-1.0, 1.0)
    return solution


def invertible(
    points: Float[Tensor, "points 2"], coefficients: Float[Tensor, "points 5"], tolerance: float
) -> bool:
    """Tell whether `undistort` inverts `distort` at all points.

    Args:
        points: Distorted points (x, y), `(P, 2)`.
        coefficients: k1, k2, p1, p2, k3, `(P, 5)`.
        tolerance: Greatest error of a coordinate, after distorting again.

    Returns:
        Whether it does.
    """
    error = distort(undistort(points, coefficients), coefficients) - points
    return bool((error.abs() < tolerance).all())
