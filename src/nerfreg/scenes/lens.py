"""OpenCV's lens distortion (k1 k2 p1 p2 k3) on normalised image coordinates, and its inverse."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

NEWTON_STEPS = 8


def distort(
    points: Float[Tensor, "points 2"], coefficients: Float[Tensor, "points 5"]
) -> Float[Tensor, "points 2"]:
    """Where an ideal pinhole point (x, y) at depth 1 lands behind the lens; y down. coefficients: k1, k2, p1, p2, k3.

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
    y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y
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
    """The inverse of `distort` by Newton's method, from the distorted point.

    Where the lens folds the image over itself there is no inverse; the result is then finite and wrong, and
    `invertible` says so.
    """
    k1, k2, p1, p2, k3 = coefficients.unbind(-1)
    solution = points
    for _ in range(NEWTON_STEPS):
        x, y = solution.unbind(-1)
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)
        dxx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        dyy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        dxy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        determinant = dxx * dyy - dxy * dxy
        # A step across the fold would run away; a floor keeps it finite.
        determinant = torch.where(determinant.abs() < 1e-2, 1e-2, determinant)
        ex, ey = (distort(solution, coefficients) - points).unbind(-1)
        step = torch.stack((dyy * ex - dxy * ey, dxx * ey - dxy * ex), -1) / determinant[:, None]
        solution = solution - step.clamp(-1.0, 1.0)
    return solution


def invertible(
    points: Float[Tensor, "points 2"], coefficients: Float[Tensor, "points 5"], tolerance: float
) -> bool:
    """Whether `undistort` finds, for all points, where they came from, to `tolerance`."""
    error = distort(undistort(points, coefficients), coefficients) - points
    return bool((error.abs() < tolerance).all())
