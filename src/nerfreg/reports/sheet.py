"""A comparison of methods on one view as a picture for a paper: a row for each method."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nerfreg.files import atomic
from nerfreg.reports.grouping import slug
from nerfreg.reports.pictures import Comparison, Crop
from nerfreg.reports.style import INK, PALETTE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS = ("photograph", "colour", "error", "depth", "photograph, detail", "colour, detail")
ERROR_MAP, DEPTH_MAP = "magma", "viridis"
BARS = ("mean absolute error", "depth, log scale")
MARGIN, GAP, HEAD, FOOT = 0.42, 0.04, 0.42, 0.36
"""Inches left of the pictures, between them, above and below."""
WIDTH = 1.75
"""Inches of a picture; the dots per inch follow from its pixels."""


def draw_sheets(comparisons: Sequence[Comparison], folder: Path) -> list[Path]:
    """One PNG for each comparison, named by scene and view. Raises NerfregError where it cannot be written."""
    return [
        draw_sheet(each, folder / f"{each.setting.name}-{slug(each.view)}.png")
        for each in comparisons
    ]


def draw_sheet(comparison: Comparison, path: Path) -> Path:
    """Rows are methods; columns photograph, colour, error, depth, and the detail of the first two.

    The detail is where the methods differ most, and is framed in the photograph and in the colours.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    height, width = comparison.photograph.shape[:2]
    grid = Grid(len(comparison.methods), WIDTH * height / width)
    with rc_context({"font.size": 8.5, "text.color": INK, "axes.labelcolor": INK}):
        figure = Figure(figsize=(grid.width, grid.height))
        for row, shown in enumerate(comparison.methods):
            images: tuple[Any, ...] = (
                comparison.photograph, shown.color, shown.error, shown.depth,
                comparison.crop.of(comparison.photograph), comparison.crop.of(shown.color),
            )  # fmt: skip
            for column, image in enumerate(images):
                panel = figure.add_axes(grid.place(row, column))
                _show(panel, image, comparison.scale)
                if row == 0:
                    panel.set_title(COLUMNS[column], fontsize=8.5, pad=3)
                if column == 0:
                    name = textwrap.shorten(
                        shown.method.replace(", ", " "), round(17 * grid.tall), placeholder=" …"
                    )
                    panel.set_ylabel(f"{name}\n{shown.psnr:.2f} dB", fontsize=8, labelpad=3)
                if column < 2:
                    _frame(panel, comparison.crop)
        scale = (("0", f"{comparison.scale:g}"), ("far", "near"))
        for column, name, ends, label in zip(
            (2, 3), (ERROR_MAP, DEPTH_MAP), scale, BARS, strict=True
        ):
            _bar(figure.add_axes(grid.bar(column)), name, ends, label)
        figure.text(
            0.02,
            1 - 0.11 / grid.height,
            f"{comparison.setting.title}: {comparison.view}",
            va="center",
        )
        with atomic(path) as part:
            figure.savefig(part, dpi=min(max(width / WIDTH, 150), 300))
    return path


@dataclass(frozen=True)
class Grid:
    """Where the pictures of a sheet stand. rows: of methods. tall: height of a picture in inches."""

    rows: int
    tall: float

    @property
    def width(self) -> float:
        """Of the sheet in inches."""
        return MARGIN + 4 * (WIDTH + GAP) + 2 * (self.tall + GAP)

    @property
    def height(self) -> float:
        """Of the sheet in inches."""
        return HEAD + self.rows * (self.tall + GAP) + FOOT

    def place(self, row: int, column: int) -> tuple[float, float, float, float]:
        """Left, bottom, width and height as shares of the sheet."""
        left = MARGIN + min(column, 4) * (WIDTH + GAP) + max(column - 4, 0) * (self.tall + GAP)
        bottom = FOOT + (self.rows - 1 - row) * (self.tall + GAP)
        wide = WIDTH if column < 4 else self.tall
        return left / self.width, bottom / self.height, wide / self.width, self.tall / self.height

    def bar(self, column: int) -> tuple[float, float, float, float]:
        """A bar of colours under a column."""
        left, _, wide, _ = self.place(0, column)
        return left, (FOOT - 0.13) / self.height, wide, 0.06 / self.height


def _show(panel: Axes, image: Any, scale: float) -> None:
    panel.imshow(image, cmap=ERROR_MAP, vmin=0, vmax=scale, aspect="auto")
    panel.set_xticks([])
    panel.set_yticks([])
    for spine in panel.spines.values():
        spine.set_visible(False)


def _frame(panel: Axes, crop: Crop) -> None:
    from matplotlib.patches import Rectangle

    corner = (crop.left - 0.5, crop.top - 0.5)
    for color, width in (("white", 1.8), (PALETTE[1], 1.0)):
        panel.add_patch(
            Rectangle(corner, crop.side, crop.side, fill=False, edgecolor=color, linewidth=width)
        )


def _bar(panel: Axes, name: str, ends: tuple[str, str], label: str) -> None:
    panel.imshow([range(256)], cmap=name, aspect="auto")
    panel.set_yticks([])
    panel.set_xticks([])
    for spine in panel.spines.values():
        spine.set_visible(False)
    for place, align, text in ((0, "left", ends[0]), (0.5, "center", label), (1, "right", ends[1])):
        panel.text(place, -0.6, text, transform=panel.transAxes, ha=align, va="top", fontsize=8)
