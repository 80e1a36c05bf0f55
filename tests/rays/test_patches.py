"""Patches and neighbours."""

from __future__ import annotations

import torch

from nerfreg.rays.patches import adjacent_pixels, patch_neighbors, patch_pixels


def test_patches_run_down_and_to_the_right() -> None:
    pixels = patch_pixels(torch.tensor([[10, 20]]), 2)
    assert pixels.tolist() == [[[[10, 20], [11, 20]], [[10, 21], [11, 21]]]]


def test_neighbours_are_one_step_away_inside_the_image_and_all_equally_likely() -> None:
    generator = torch.Generator().manual_seed(0)
    pixels = torch.tensor([[1, 1], [0, 0], [3, 2]]).repeat(4000, 1)
    neighbors = adjacent_pixels(pixels, 4, 3, generator)
    assert ((neighbors - pixels).abs().sum(dim=1) == 1).all()
    assert (neighbors >= 0).all() and (neighbors < torch.tensor([4, 3])).all()
    steps = (neighbors - pixels).view(4000, 3, 2)
    for index, choices in enumerate((4, 2, 2)):  # inside, and in two corners
        _, counts = steps[:, index].unique(dim=0, return_counts=True)
        assert len(counts) == choices
        # four standard deviations of a binomial count
        expected = 4000 / choices
        assert ((counts - expected).abs() < 4 * (expected * (1 - 1 / choices)) ** 0.5).all()


def test_patch_neighbours_stay_in_their_patch_and_touch() -> None:
    pairs = patch_neighbors(5, 3, torch.Generator().manual_seed(0))
    assert torch.equal(pairs[:, 0], torch.arange(45))
    assert torch.equal(pairs[:, 0] // 9, pairs[:, 1] // 9)
    place = torch.stack([pairs % 3, pairs % 9 // 3], dim=-1)
    assert ((place[:, 0] - place[:, 1]).abs().sum(dim=-1) == 1).all()
