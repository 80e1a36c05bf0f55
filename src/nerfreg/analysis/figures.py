"""How every figure looks and is written: colours, panels, guides, files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from nerfreg.files import atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Of Okabe and Ito (2008): told apart by all kinds of colour vision.

Black and yellow of the same palette are left out: they vanish on a dark and on a light page. Lower
case, as matplotlib writes colours to SVG, since a page replaces them there by its own.
"""
MARKERS = ("o", "s", "^", "D", "v", "p", "<", ">", "h", "d")
DASHES: tuple[Any, ...] = ("solid", (0, (5, 1.6)), (0, (5, 1.5, 1, 1.5)))
INK, GUIDE, GRID = "#1b1f24", "#6b7280", "#e4e6e9"
"""Text; axes, notes and guides; the grid."""
DPI = 200.0


@dataclass(frozen=True)
class Style:
    """How one of the things that are compared is drawn.

    Attributes:
        label: What the legend calls it.
        color: Of its line and marker.
        marker: As matplotlib names it.
        dash: Line style, as matplotlib takes it.
    """

    label: str
    color: str
    marker: str
    dash: Any = "solid"


def styles(labels: Sequence[str]) -> list[Style]:
    """Return a style for each label, all different up to thirty of them."""
    return [
        Style(
            label,
            PALETTE[index % len(PALETTE)],
            MARKERS[index % len(MARKERS)],
            DASHES[index // len(PALETTE) % len(DASHES)],
        )
        for index, label in enumerate(labels)
    ]


@contextmanager
def panels(
    rows: int,
    columns: int | Sequence[float],
    width: float,
    height: float,
    scale: Literal["linear", "log"] = "log",
    text: float = 9.5,
) -> Iterator[tuple[Figure, list[list[Axes]]]]:
    """Yield a figure and its panels by row and column, in a style that holds inside the block.

    Args:
        rows: Number of panels above each other.
        columns: Number of panels beside each other, or their widths relative to each other.
        width: Of the figure in inches.
        height: Of the figure in inches.
        scale: Of both axes.
        text: Size of the text in points.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    style: dict[Any, Any] = {
        "font.size": text,
        "figure.titlesize": text + 1,
        "axes.titlesize": text + 0.5,
        "axes.labelsize": text,
        "xtick.labelsize": text - 0.5,
        "ytick.labelsize": text - 0.5,
        "legend.fontsize": text - 0.5,
        "legend.handlelength": 2.6,
        "text.color": INK,
        "axes.labelcolor": INK,
        "axes.titlecolor": INK,
        "xtick.color": INK,
        "ytick.color": INK,
        "axes.edgecolor": GUIDE,
        "axes.linewidth": 0.7,
        "xtick.major.width": 0.7,
        "ytick.major.width": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.facecolor": "none",
        "figure.facecolor": "white",
        "lines.linewidth": 1.5,
        "lines.markersize": 5.0,
        # Text stays text, and identical figures are written as identical bytes.
        "svg.fonttype": "none",
        "svg.hashsalt": "nerfreg",
    }
    with rc_context(style):
        figure = Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.07))
        widths = [1.0] * columns if isinstance(columns, int) else columns
        axes = figure.subplots(rows, len(widths), squeeze=False, width_ratios=widths)
        for panel in axes.flat:
            panel.set_xscale(scale)
            panel.set_yscale(scale)
            panel.grid(color=GRID, linewidth=0.6)
            panel.set_axisbelow(True)
        yield figure, axes.tolist()


def save(
    figure: Figure, stem: Path, suffixes: Sequence[str] = (".png", ".svg"), dpi: float = DPI
) -> list[Path]:
    """Write a figure to STEM.png and STEM.svg, and return the paths.

    Raises:
        NerfregError: A file cannot be written.
    """
    figure.draw_without_rendering()
    # The layout takes as long as the drawing, and is the same for both.
    figure.set_layout_engine("none")
    paths = [stem.with_name(f"{stem.name}{suffix}") for suffix in suffixes]
    for path in paths:
        with atomic(path) as part:
            metadata = {"Date": None} if path.suffix == ".svg" else None
            figure.savefig(part, dpi=dpi, metadata=metadata)
    return paths


def shortened(text: str, length: int) -> str:
    """Return a text of at most `length` characters.

    What is left out is in the middle, since long names differ at their ends.
    """
    head = (length - 1) // 2
    return text if len(text) <= length else f"{text[:head]}…{text[len(text) - length + 1 + head :]}"
