"""A comparison of methods on one view as a picture for a paper: a row for each method."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

from matplotlib.cm import ScalarMappable
from matplotlib.patches import Rectangle

from nerfreg.analysis.figures import PALETTE, panels, save
from nerfreg.reports.pictures import ComparedView
from nerfreg.reports.records import slug

COLUMNS = ("photograph", "colour", "error", "depth", "photograph, detail", "colour, detail")
ERROR_MAP, DEPTH_MAP = "magma", "viridis"
WIDTH = 1.75
"""Inches of a picture; the dots per inch follow from its pixels."""


def draw_sheet(compared: ComparedView, folder: Path) -> list[Path]:
    """Draw a row for each method: photograph, colour, error, depth, and details of the first two.

    The detail is where the methods differ most, and is framed in the photograph and in the colours.
    The file is a PNG, named by scene and view.

    Raises:
        NerfregError: The file cannot be written.
    """
    pixels, crop, count = compared.photograph.shape[1], compared.crop, len(compared.methods)
    tall = WIDTH * compared.photograph.shape[0] / pixels
    size = (4 * WIDTH + 2 * tall + 0.7, count * (tall + 0.05) + 0.8)
    widths = [WIDTH] * 4 + [tall] * 2
    with panels(count, widths, *size, "linear", 8.5) as (figure, rows):
        figure.suptitle(compared.title)
        figure.set_layout_engine("constrained", w_pad=0.02, h_pad=0.02, wspace=0, hspace=0)
        for method, row in zip(compared.methods, rows, strict=True):
            photograph, color = compared.photograph, method.color
            details = (crop.of(photograph), crop.of(color))
            images = (photograph, color, method.error, method.depth, *details)
            for panel, image in zip(row, images, strict=True):
                panel.imshow(image, cmap=ERROR_MAP, vmin=0, vmax=compared.scale)
                panel.set(xticks=[], yticks=[])
                panel.spines[:].set_visible(False)
            for panel in row[:2]:
                corner = (crop.left - 0.5, crop.top - 0.5)
                for edge, width in (("white", 1.8), (PALETTE[1], 1.0)):
                    look: dict[str, Any] = {"edgecolor": edge, "linewidth": width}
                    panel.add_patch(Rectangle(corner, crop.side, crop.side, fill=False, **look))
            name = method.method.replace(", ", " ")
            name = textwrap.shorten(name, max(round(17 * tall), 8), placeholder=" …")
            row[0].set_ylabel(f"{name}\n{method.psnr:.2f} dB", fontsize=8)
        for panel, title in zip(rows[0], COLUMNS, strict=True):
            panel.set_title(title, fontsize=8.5)
        scales = {
            2: (ERROR_MAP, "mean absolute error", ("0", f"{compared.scale:g}")),
            3: (DEPTH_MAP, "depth, log scale", ("far", "near")),
        }
        for column, (colors, label, ends) in scales.items():
            below = rows[-1][column].inset_axes((0, -0.09, 1, 0.04))
            bar = figure.colorbar(ScalarMappable(cmap=colors), below, orientation="horizontal")
            bar.set_ticks([0, 1], labels=list(ends))
            bar.set_label(label, labelpad=-8)
        stem = folder / f"{compared.setting.name}-{slug(compared.view)}"
        return save(figure, stem, (".png",), dpi=min(max(pixels / WIDTH, 150.0), 300.0))
