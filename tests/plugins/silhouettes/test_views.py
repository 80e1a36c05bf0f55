"""Silhouettes without lens distortion, and what lies outside of them."""

from __future__ import annotations

import pytest
import torch
from nerfreg_plugins.silhouettes.views import PinholeView, _undistorted

from nerfreg.scenes import lens
from nerfreg.scenes.cameras import Cameras

SIZE = 24


def camera(distortion: tuple[float, ...], focal: float = 20.0) -> Cameras:
    center = torch.tensor([[SIZE / 2 + 0.3, SIZE / 2 - 0.2]])
    pose = torch.eye(4)[None, :3]
    coefficients = torch.tensor([distortion])
    return Cameras(SIZE, SIZE, pose, torch.full((1, 2), focal), center, coefficients)


@pytest.mark.parametrize(
    "distortion",
    [
        (-0.25, 0.05, 0.0, 0.0, 0.0),
        # A pixel of the pinhole's image is up to five pixels of the photograph wide.
        (4.0, 0.0, 0.0, 0.0, 0.0),
        (0.2, -0.1, -0.03, 0.02, 0.05),
    ],
)
def test_every_part_of_a_covered_pixel_is_covered(distortion):
    made = camera(distortion)
    draw = torch.Generator().manual_seed(0)
    for x, y in torch.randint(0, SIZE, (60, 2), generator=draw).tolist():
        covered = torch.zeros(SIZE, SIZE, dtype=torch.bool)
        covered[y, x] = True
        found, beyond, center = _undistorted(made, 0, covered)
        points = torch.rand(100, 2, generator=draw) + torch.tensor([x, y])
        seen = (points - made.center[0]) / made.focal[0]
        ideal = lens.undistort(seen, made.distortion.expand(100, 5)) * made.focal[0] + center
        column, row = ideal.floor().long().unbind(dim=1)
        assert found[row, column].all()
        assert beyond.any() and not beyond.all()


def test_what_is_beyond_the_fold_of_a_lens_is_not_shown():
    # The distorted radius rises up to an ideal radius of 1, and falls behind it.
    made = camera((0.1, -0.26, 0.0, 0.0, 0.0))
    covered = torch.ones(SIZE, SIZE, dtype=torch.bool)
    found, beyond, center = _undistorted(made, 0, covered)
    rows, columns = found.shape
    y, x = torch.meshgrid(torch.arange(rows) + 0.5, torch.arange(columns) + 0.5, indexing="ij")
    ideal = (torch.stack([x, y], dim=-1) - center) / made.focal[0]
    coefficients = made.distortion.expand(rows * columns, 5)
    shown = lens.distort(ideal.view(-1, 2), coefficients)
    again = lens.undistort(shown, coefficients).view_as(ideal)
    folded = (again - ideal).norm(dim=-1) > 0.1
    inside = (shown * made.focal[0] + made.center[0]).view_as(ideal)
    inside = ((inside >= 0) & (inside < SIZE)).all(dim=-1)
    assert (folded & inside).any()
    assert not found[folded].any()
    assert beyond[folded].all()


@pytest.mark.parametrize(("distance", "closed"), [(0, False), (1, False), (2, True), (5, True)])
@pytest.mark.parametrize("side", range(4))
def test_a_silhouette_within_the_margin_of_the_border_is_open(distance, closed, side):
    covered = torch.zeros(SIZE, SIZE, dtype=torch.bool)
    covered[distance, 12] = True
    made = camera((0.0,) * 5)
    turned = torch.rot90(covered, side)
    assert PinholeView.of(made, 0, turned, 1.0, True).open is not closed
    assert PinholeView.of(made, 0, turned, 1.0, False).open
    assert PinholeView.of(made, 0, turned, 0.0, True).open is (distance == 0)
