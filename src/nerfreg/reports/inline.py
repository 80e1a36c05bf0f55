"""Figures and pictures as parts of a page: SVG that takes its colours from the page, images as data URIs."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import UInt8

from nerfreg.reports.style import FAINT, GRID, GUIDE, INK, PALETTE

COLORS = {
    INK: "ink", GUIDE: "guide", FAINT: "faint", GRID: "grid", "#ffffff": "page",
    **{color: f"series-{index}" for index, color in enumerate(PALETTE)},
}  # fmt: skip
"""Colours of the figures, and the names of those that a page has in their place."""


def themed_svg(text: str, name: str) -> str:
    """The `svg` element of a file by matplotlib, in the colours of the page, with ids that begin with `name`.

    It has no size of its own, and no link that leaves the page.
    """
    element = text[text.index("<svg") :]
    element = re.sub(r"<metadata>.*?</metadata>", "", element, flags=re.DOTALL)
    element = re.sub(
        r'(<svg[^>]*?) width="[^"]*"', r"\1", re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", element)
    )
    element = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', element)
    element = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', element)
    element = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", element)
    for color, variable in COLORS.items():
        element = element.replace(color, f"var(--{variable})")
    return element


def data_uris(images: Sequence[UInt8[np.ndarray, "_ _ 3"]], budget: int) -> list[str]:
    """Images as data URIs of at most `budget` characters together, all encoded alike, so that they can be compared.

    Without loss if that fits, else as JPEG, else also smaller.
    """
    encoded: list[str] = []
    for encode in ENCODERS:
        encoded = [encode(image) for image in images]
        if sum(map(len, encoded)) <= budget:
            break
    return encoded


def _png(image: UInt8[np.ndarray, "_ _ 3"]) -> str:
    return _uri(image, "png", {"optimize": False})


def _jpeg(image: UInt8[np.ndarray, "_ _ 3"], quality: int, stride: int = 1) -> str:
    return _uri(smaller(image, stride), "jpeg", {"quality": quality, "subsampling": 0})


def _uri(image: UInt8[np.ndarray, "_ _ 3"], kind: str, options: dict[str, Any]) -> str:
    import imageio.v3 as iio

    encoded = iio.imwrite("<bytes>", image, extension=f".{kind}", **options)
    return f"data:image/{kind};base64,{b64encode(encoded).decode()}"


def smaller(image: UInt8[np.ndarray, "_ _ 3"], factor: int) -> UInt8[np.ndarray, "_ _ 3"]:
    """Means over squares of factor x factor pixels; what is left over at the right and below is cut off."""
    height, width = (max(size // factor, 1) for size in image.shape[:2])
    if factor == 1 or min(image.shape[:2]) < factor:
        return image
    squares = image[: height * factor, : width * factor].reshape(height, factor, width, factor, 3)
    return squares.mean((1, 3)).round().astype(np.uint8)


ENCODERS: tuple[Callable[[UInt8[np.ndarray, "_ _ 3"]], str], ...] = (
    _png,
    partial(_jpeg, quality=92),
    partial(_jpeg, quality=80),
    partial(_jpeg, quality=80, stride=2),
    partial(_jpeg, quality=70, stride=4),
)
"""From the best to the smallest."""
