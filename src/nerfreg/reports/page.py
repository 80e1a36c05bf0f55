"""The report as one page that needs nothing else: `report.html`, made of `template/`."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.colors import to_hex

from nerfreg import __version__
from nerfreg.analysis.figures import GRID, GUIDE, INK, PALETTE
from nerfreg.files import write_text
from nerfreg.reports.pictures import ComparedView, Image
from nerfreg.reports.records import NamedRun, by_setting
from nerfreg.reports.sheet import DEPTH_MAP, ERROR_MAP
from nerfreg.reports.tables import Table
from nerfreg.reports.templates import template

NAME = "report.html"
PICTURE_BUDGET = 12_000_000
"""Characters that all pictures together may take, so that the page stays below 15 MB."""
ENCODINGS = (("png", None, 1), ("jpeg", 92, 1), ("jpeg", 80, 1), ("jpeg", 80, 2), ("jpeg", 70, 4))
"""File type, quality, by what to divide the size of a picture, from the best to the smallest."""
COLORS = {INK: "ink", GUIDE: "guide", GRID: "grid", "#ffffff": "page"}
COLORS |= {color: f"series-{index}" for index, color in enumerate(PALETTE)}
"""Colours of the figures, and the names of those that a page has in their place."""


def write_page(
    runs: Sequence[NamedRun],
    tables: Sequence[Table],
    figures: Sequence[Path],
    compared: Sequence[ComparedView],
    notes: Sequence[str],
    folder: Path,
) -> Path:
    """Write FOLDER/report.html, and return its path.

    Args:
        runs: All of them.
        tables: Those of scores and costs.
        figures: Files of figures; the SVG are shown.
        compared: The test views to show.
        notes: On what is not shown of test views.
        folder: Where the report goes.

    Raises:
        NerfregError: The page cannot be written.
    """
    images = {key: image for view in compared for key, image in _images(view).items()}
    encoded = data_uris(list(images.values()), PICTURE_BUDGET)
    text = template("report.html.j2").render(
        version=__version__,
        tables=tables,
        figures={path.stem: _figure(path) for path in figures if path.suffix == ".svg"},
        views=compared,
        images=dict(zip(images, encoded, strict=True)),
        notes=notes,
        runs=runs,
        settings=[setting.title for setting in by_setting(runs)],
        methods=len({run.method for run in runs}),
        error_map=_gradient(ERROR_MAP),
        depth_map=_gradient(DEPTH_MAP),
    )
    write_text(folder / NAME, text)
    return folder / NAME


def themed_svg(text: str, name: str) -> str:
    """Return the `svg` element of a file by matplotlib in the colours of the page.

    It has no size of its own, and no link that leaves the page. Its ids begin with `name`.
    """
    element = text[text.index("<svg") :]
    element = re.sub(r"<metadata>.*?</metadata>", "", element, flags=re.DOTALL)
    for size in ("width", "height"):
        element = re.sub(rf'(<svg[^>]*?) {size}="[^"]*"', r"\1", element)
    element = re.sub(r'(\bid="|href="#|url\(#)', rf"\1{name}-", element)
    for color, variable in COLORS.items():
        element = element.replace(color, f"var(--{variable})")
    return element


def data_uris(images: Sequence[Image], budget: int) -> list[str]:
    """Return images as data URIs of at most `budget` characters together.

    All are encoded alike, so that they can be compared: without loss if that fits, else as JPEG,
    else also smaller.
    """
    encoded: list[str] = []
    for kind, quality, factor in ENCODINGS:
        options: Any = {} if quality is None else {"quality": quality, "subsampling": 0}
        small = [smaller(image, factor) for image in images]
        files = [iio.imwrite("<bytes>", image, extension=f".{kind}", **options) for image in small]
        encoded = [f"data:image/{kind};base64,{b64encode(file).decode()}" for file in files]
        if sum(map(len, encoded)) <= budget:
            break
    return encoded


def smaller(image: Image, factor: int) -> Image:
    """Return means over squares of pixels; what is left over at the right and below is cut off."""
    height, width = (size // factor for size in image.shape[:2])
    if factor == 1 or not height or not width:
        return image
    squares = image[: height * factor, : width * factor].reshape(height, factor, width, factor, 3)
    return np.asarray(squares.mean((1, 3)).round(), np.uint8)


def _figure(path: Path) -> Markup:
    return Markup(themed_svg(path.read_text(encoding="utf-8"), path.stem))


def _images(view: ComparedView) -> dict[tuple[str, str, str], Image]:
    """Return the pictures of a view by its name, the method, and what they show of it."""
    crop, colors = view.crop, matplotlib.colormaps[ERROR_MAP]
    images = {("photograph", "colour"): view.photograph}
    images["photograph", "detail"] = crop.of(view.photograph)
    for own in view.methods:
        error = colors(np.clip(own.error / view.scale, 0, 1))[..., :3] * 255
        images[own.method, "colour"] = own.color
        images[own.method, "detail"] = crop.of(own.color)
        images[own.method, "error"] = error.round().astype(np.uint8)
        images[own.method, "depth"] = own.depth
    return {(view.name, method, kind): image for (method, kind), image in images.items()}


def _gradient(name: str) -> str:
    """Return a colour map as the stops of a CSS gradient."""
    return ", ".join(to_hex(matplotlib.colormaps[name](stop)) for stop in np.linspace(0, 1, 11))
