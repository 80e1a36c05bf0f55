from __future__ import annotations

from nerfreg_plugins.references.silhouettes import projected_corners


def test_by_hand(numbers):
    # A cube of side 2, whose near face is at depth 1 and whose far face is at depth 3.
    axes = numbers([[1, 0, 0], [0, -1, 0], [0, 0, -1]])
    points = projected_corners(
        *(numbers(value) for value in ([0, 0, 0], 1, [0, 0, 2])),
        axes,
        *(numbers(value) for value in ([6, 12], [8, 4])),
    )
    assert sorted(points) == [
        (2, -8), (2, 16), (6, 0), (6, 8), (10, 0), (10, 8), (14, -8), (14, 16),
    ]  # fmt: skip
