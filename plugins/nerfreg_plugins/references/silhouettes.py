"""Exact projection of cubes, of which the cells of `silhouettes` consist."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from mpmath import mpf


def projected_corners(
    center: Sequence[mpf],
    half: mpf,
    position: Sequence[mpf],
    axes: Sequence[Sequence[mpf]],
    focal: Sequence[mpf],
    principal: Sequence[mpf],
) -> list[tuple[mpf, mpf]]:
    """Project the corners of a cube in front of a pinhole camera.

    Args:
        center: Centre of the cube, whose sides are aligned with the axes of the world.
        half: Half its sides.
        position: Position of the camera.
        axes: Unit vectors right, down and forward of the camera.
        focal: Focal lengths in pixels.
        principal: Principal point in pixels.

    Returns:
        Points (x, y) in pixels. Their convex hull is the projection of the cube.
    """
    points = []
    for signs in product((-1, 1), repeat=3):
        offset = [c + sign * half - p for c, sign, p in zip(center, signs, position, strict=True)]
        right, down, forward = (
            sum((a * b for a, b in zip(axis, offset, strict=True)), mpf(0)) for axis in axes
        )
        points.append(
            (
                focal[0] * right / forward + principal[0],
                focal[1] * down / forward + principal[1],
            )
        )
    return points
