"""Square pixel patches and pairs of adjacent pixels, as index arithmetic."""

from __future__ import annotations

import torch
from jaxtyping import Int
from torch import Tensor

STEPS = torch.tensor([[1, 0], [-1, 0], [0, 1], [0, -1]])
"""Offsets from a pixel (x, y) to its four neighbours."""


def patch_pixels(
    corners: Int[Tensor, "patches 2"], side: int
) -> Int[Tensor, "patches side side 2"]:
    """List the pixels of square patches.

    Args:
        corners: Upper left pixels (x, y), `(P, 2)`.
        side: Pixels per side, S.

    Returns:
        Pixels (x, y), `(P, S, S, 2)`; rows run down the image, columns to the right.
    """
    y, x = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    return corners[:, None, None] + torch.stack([x, y], dim=-1)


def adjacent_pixels(
    pixels: Int[Tensor, "*pixels 2"], width: int, height: int, generator: torch.Generator
) -> Int[Tensor, "*pixels 2"]:
    """Choose one of the four neighbours of each pixel, uniformly among those inside the image.

    Args:
        pixels: Pixels (x, y), `(..., 2)`.
        width: Width of the image, at least 2 pixels.
        height: Height of the image, at least 2 pixels.
        generator: Source of the choice.

    Returns:
        The neighbours (x, y), `(..., 2)`.
    """
    neighbors = pixels[..., None, :] + STEPS
    inside = ((neighbors >= 0) & (neighbors < torch.tensor([width, height]))).all(dim=-1)
    # The greatest of equally distributed numbers is a uniform choice, without a loop over pixels
    # that have two, three or four neighbours.
    scores = torch.rand(inside.shape, generator=generator).masked_fill(~inside, -1)
    choice = scores.argmax(dim=-1)[..., None, None].expand(*pixels.shape[:-1], 1, 2)
    return neighbors.gather(-2, choice).squeeze(-2)


def patch_neighbors(patches: int, side: int, generator: torch.Generator) -> Int[Tensor, "pairs 2"]:
    """Pair each pixel of square patches with a neighbour inside the same patch.

    Args:
        patches: Number of patches.
        side: Pixels per side, at least 2.
        generator: Source of the choice.

    Returns:
        Pairs (pixel, neighbour), one per pixel, as indices into the pixels of all patches in
        row-major order.
    """
    pixels = patch_pixels(torch.zeros(patches, 2, dtype=torch.long), side)
    neighbors = adjacent_pixels(pixels, side, side, generator)
    first = torch.arange(patches)[:, None, None] * side * side
    index = first + pixels[..., 1] * side + pixels[..., 0]
    partner = first + neighbors[..., 1] * side + neighbors[..., 0]
    return torch.stack([index.flatten(), partner.flatten()], dim=1)
