"""LPIPS (Zhang et al. 2018): a distance between images, measured in the feature maps of AlexNet. Version 0.1."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor
from torch.nn import functional

from nerfreg.errors import NerfregError
from nerfreg.evaluation.lpips_weights import HOW_TO_GET_WEIGHTS, LAYERS, find_lpips_weights

log = logging.getLogger(__name__)

STRIDES = (4, 1, 1, 1, 1)
PADDING = (2, 2, 1, 1, 1)
POOLED_BEFORE = (1, 2)
"""Convolutions whose input is max-pooled first."""

MIN_SIDE = 31
"""Smallest image side that leaves one pixel after the second pooling: 31 -> 7 (conv) -> 3 (pool) -> 1 (pool)."""

SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)
"""ImageNet mean and deviation, for images in [-1, 1]."""


@dataclass(frozen=True)
class LPIPS:
    """AlexNet's five convolutions and one linear head on each, as published.

    convolutions: (weight, bias) of each layer. heads: (1, C, 1, 1) weights of the squared channel differences.
    """

    convolutions: tuple[tuple[Tensor, Tensor], ...]
    heads: tuple[Tensor, ...]

    @classmethod
    def load(cls, path: Path) -> LPIPS:
        """Read `convI.weight`, `convI.bias` and `linI.weight`, I from 0 to 4, of a safetensors file."""
        try:
            tensors = load_file(path)
            convolutions = tuple(
                (tensors[f"conv{i}.weight"], tensors[f"conv{i}.bias"]) for i in range(LAYERS)
            )
            heads = tuple(tensors[f"lin{i}.weight"] for i in range(LAYERS))
        except (OSError, SafetensorError, KeyError) as error:
            raise NerfregError(
                f"{path}: eval.lpips_weights holds no LPIPS AlexNet weights ({error})"
            ) from error
        return cls(convolutions, heads)

    @torch.no_grad()
    def __call__(
        self, image: Float[Tensor, "height width 3"], target: Float[Tensor, "height width 3"]
    ) -> float | None:
        """LPIPS of two images in [0, 1]; None where they are too small for AlexNet (a side below 31 pixels)."""
        if min(image.shape[:2]) < MIN_SIDE:
            return None
        pair = torch.stack([image, target]).movedim(-1, 1) * 2 - 1
        x = (pair - pair.new_tensor(SHIFT).view(3, 1, 1)) / pair.new_tensor(SCALE).view(3, 1, 1)
        distance = 0.0
        for i, (weight, bias) in enumerate(self.convolutions):
            if i in POOLED_BEFORE:
                x = functional.max_pool2d(x, kernel_size=3, stride=2)
            x = functional.relu(
                functional.conv2d(x, weight, bias, stride=STRIDES[i], padding=PADDING[i])
            )
            unit = x / (x.square().sum(1, keepdim=True).sqrt() + 1e-10)
            difference = (unit[0] - unit[1]).square()
            distance += functional.conv2d(difference, self.heads[i]).mean().item()
        return distance


def load_lpips(configured: str | None) -> LPIPS | None:
    """LPIPS with the weights that `find_lpips_weights` finds; None, and one logged line, where there are none."""
    path = find_lpips_weights(configured)
    if path is None:
        log.warning(HOW_TO_GET_WEIGHTS)
        return None
    return LPIPS.load(path)
