"""What a page holds instead of links: SVG in its own colours, images as data URIs."""

from __future__ import annotations

from base64 import b64decode

import imageio.v3 as iio
import numpy as np
import pytest

from nerfreg.analysis.figures import INK, PALETTE
from nerfreg.reports.page import data_uris, smaller, themed_svg

SVG = f"""<?xml version="1.0"?>
<!DOCTYPE svg PUBLIC "-//W3C//DTD SVG 1.1//EN" "http://www.w3.org/Graphics/SVG/1.1/DTD/svg11.dtd">
<svg xmlns:xlink="http://www.w3.org/1999/xlink" width="100pt" height="50pt" viewBox="0 0 100 50">
 <metadata><a href="https://matplotlib.org/">about</a></metadata>
 <defs><path id="m1" d="M 0 0" style="stroke: {INK}"/></defs>
 <g id="axes_1" clip-path="url(#p2)">
  <use xlink:href="#m1" style="fill: {PALETTE[1]}; stroke: #ffffff"/>
 </g>
 <rect width="5" height="6"/>
</svg>
"""


def test_a_figure_takes_the_colours_of_the_page_and_leaves_no_link() -> None:
    element = themed_svg(SVG, "curves")
    assert element.startswith("<svg") and "metadata" not in element and "DTD" not in element
    assert 'style="stroke: var(--ink)"' in element
    assert 'style="fill: var(--series-1); stroke: var(--page)"' in element
    assert "https://" not in element


def test_ids_and_what_refers_to_them_belong_to_the_figure() -> None:
    element = themed_svg(SVG, "curves")
    assert 'id="curves-m1"' in element and 'xlink:href="#curves-m1"' in element
    assert 'id="curves-axes_1"' in element and "url(#curves-p2)" in element


def test_a_figure_is_as_large_as_its_place_and_its_parts_keep_their_size() -> None:
    element = themed_svg(SVG, "curves")
    head, rest = element.split(">", 1)
    assert "width" not in head and "height" not in head and 'viewBox="0 0 100 50"' in head
    assert '<rect width="5" height="6"/>' in rest


def noise(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)


def test_what_fits_is_encoded_without_loss() -> None:
    images = [noise(8, 10), noise(5, 6)]
    encoded = data_uris(images, 10_000)
    for uri, image in zip(encoded, images, strict=True):
        kind, content = uri.split(",")
        assert kind == "data:image/png;base64"
        assert np.array_equal(iio.imread(b64decode(content)), image)


def test_what_does_not_fit_is_encoded_smaller_and_all_alike() -> None:
    images = [noise(64, 64), np.zeros((64, 64, 3), np.uint8)]
    whole = sum(map(len, data_uris(images, 1_000_000)))
    encoded = data_uris(images, whole - 1)
    assert sum(map(len, encoded)) < whole
    assert all(uri.startswith("data:image/jpeg") for uri in encoded), (
        "also the one that would have been small"
    )


def test_what_never_fits_is_as_small_as_it_gets() -> None:
    (uri,) = data_uris([noise(64, 64)], 1)
    assert iio.imread(b64decode(uri.split(",")[1])).shape == (16, 16, 3)
    assert data_uris([], 0) == []


def test_smaller_images_are_means_of_squares() -> None:
    image = np.array([[0, 2, 9], [4, 6, 9], [9, 9, 9]], np.uint8)[..., None].repeat(3, -1)
    assert smaller(image, 2)[..., 0].tolist() == [[3]]  # (0 + 2 + 4 + 6) / 4; the rest is cut off
    assert smaller(image, 1) is image and smaller(image, 4) is image


@pytest.mark.parametrize("color", PALETTE)
def test_colours_stand_in_svg_as_matplotlib_writes_them(color: str) -> None:
    assert color == color.lower()
