"""Square pixel patches and pairs of adjacent pixels, as index arithmetic."""

from __future__ import annotations

import torch
from jaxtyping import Int
from torch import Tensor

STEPS = torch.tensor([[1, 0], [-1, 0], [0, 1], [0, -1]])
"""From a pixel (x, y) to its four neighbours."""


def patch_pixels(
    corners: Int[Tensor, "patches 2"], side: int
) -> Int[Tensor, "patches side side 2"]:
    """Pixels (x, y) of square patches with the given upper left corners: rows run down, columns to the right."""
    y, x = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    return corners[:, None, None] + torch.stack([x, y], dim=-1)


def adjacent_pixels(
    pixels: Int[Tensor, "*pixels 2"], width: int, height: int, generator: torch.Generator
) -> Int[Tensor, "*pixels 2"]:
    """One of the four neighbours of each pixel, chosen uniformly among those inside the image; it must be 2 x 2."""
    neighbors = pixels[..., None, :] + STEPS
    inside = ((neighbors >= 0) & (neighbors < torch.tensor([width, height]))).all(dim=-1)
    scores = torch.rand(inside.shape, generator=generator).masked_fill(~inside, -1)
    choice = scores.argmax(dim=-1)[..., None, None].expand(*pixels.shape[:-1], 1, 2)
    return neighbors.gather(-2, choice).squeeze(-2)


def patch_neighbors(patches: int, side: int, generator: torch.Generator) -> Int[Tensor, "pairs 2"]:
    """Pairs (pixel, neighbour) within patches, as indices into their pixels in row-major order; one for each pixel."""
    pixels = patch_pixels(torch.zeros(patches, 2, dtype=torch.long), side)
    neighbors = adjacent_pixels(pixels, side, side, generator)
    first = torch.arange(patches)[:, None, None] * side * side
    index = first + pixels[..., 1] * side + pixels[..., 0]
    partner = first + neighbors[..., 1] * side + neighbors[..., 0]
    return torch.stack([index.flatten(), partner.flatten()], dim=1)
