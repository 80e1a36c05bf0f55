"""LPIPS (Zhang et al. 2018): a distance between images in the feature maps of AlexNet.

This is version 0.1 of the authors' weights, with a forward pass of our own: neither torchvision nor
the lpips package is needed.
"""

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
"""Strides and padding of AlexNet's convolutions, as torchvision has them."""

POOLED_BEFORE = (1, 2)
"""Convolutions whose input is max-pooled first. The third pooling follows the last features."""

MIN_SIDE = 31
"""Shortest image side that leaves a pixel after the second pooling: 31, after the first convolution
7, after the poolings 3 and 1."""

SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)
"""Mean and deviation of ImageNet, for images in [-1, 1] (the constants of the authors' code)."""


@dataclass(frozen=True)
class LPIPS:
    """AlexNet's five convolutions and one linear head on each, as published.

    Attributes:
        convolutions: Weight and bias of each convolution.
        heads: Weights of the squared channel differences of each layer, `(1, C, 1, 1)`.
    """

    convolutions: tuple[tuple[Tensor, Tensor], ...]
    heads: tuple[Tensor, ...]

    @classmethod
    def load(cls, path: Path) -> LPIPS:
        """Read the weights from a file.

        Args:
            path: A safetensors file with `convI.weight`, `convI.bias` and `linI.weight`, I from 0
                to 4.

        Returns:
            LPIPS with these weights.

        Raises:
            NerfregError: If the file cannot be read or lacks a weight.
        """
        try:
            tensors = load_file(path)
            convolutions = tuple(
                (tensors[f"conv{i}.weight"], tensors[f"conv{i}.bias"]) for i in range(LAYERS)
            )
            heads = tuple(tensors[f"lin{i}.weight"] for i in range(LAYERS))
        except (OSError, SafetensorError, KeyError) as error:
            raise NerfregError(
                f"{path}: eval.lpips_weights has no AlexNet weights of LPIPS ({error}); "
                "leave it null to look for the weights"
            ) from error
        return cls(convolutions, heads)

    @torch.no_grad()
    def __call__(
        self, image: Float[Tensor, "height width 3"], target: Float[Tensor, "height width 3"]
    ) -> float | None:
        """Compute LPIPS.

        Args:
            image: An image in [0, 1].
            target: An image in [0, 1] of the same size.

        Returns:
            The distance; None if a side is shorter than `MIN_SIDE`, too small for AlexNet.
        """
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
            # Outside of the root, as in the authors' code: scores must agree with published ones.
            unit = x / (x.square().sum(1, keepdim=True).sqrt() + 1e-10)
            difference = (unit[0] - unit[1]).square()
            distance += functional.conv2d(difference, self.heads[i]).mean().item()
        return distance


def load_lpips(configured: str | None) -> LPIPS | None:
    """Load LPIPS with the weights that `find_lpips_weights` finds.

    Args:
        configured: The value of `eval.lpips_weights`.

    Returns:
        LPIPS; None, with a line in the log that tells how to get them, if there are no weights.

    Raises:
        NerfregError: If the configured file is missing or holds no such weights.
    """
    path = find_lpips_weights(configured)
    if path is None:
        log.warning(HOW_TO_GET_WEIGHTS)
        return None
    return LPIPS.load(path)
