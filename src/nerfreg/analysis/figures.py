"""What the plots of all benches have in common: colours, axes, slopes to compare with, and how they are written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nerfreg.files import atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Of Okabe and Ito (2008): told apart by all kinds of colour vision."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
GUIDE = "#7a7a7a"
DPI = 160


@dataclass(frozen=True)
class Style:
    """How one of the things that are compared is drawn, and what the legend calls it."""

    label: str
    color: str
    marker: str


def styles(labels: Sequence[str]) -> list[Style]:
    """A colour and a marker for each."""
    return [
        Style(label, PALETTE[index % len(PALETTE)], MARKERS[index % len(MARKERS)])
        for index, label in enumerate(labels)
    ]


@contextmanager
def panels(
    rows: int, columns: int, width: float, height: float
) -> Iterator[tuple[Figure, list[list[Axes]]]]:
    """A figure of log-log panels, its size in inches, in the style of all benches, which holds inside the block."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    style: Any = {
        "font.size": 9.5,
        "axes.titlesize": 10.5,
        "axes.labelsize": 9.5,
        "xtick.labelsize": 8.5,
        "ytick.labelsize": 8.5,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "lines.linewidth": 1.4,
        "lines.markersize": 4.0,
        "svg.fonttype": "none",
        "svg.hashsalt": "nerfreg",
    }
    with rc_context(style):
        figure = Figure(figsize=(width, height), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
        for panel in axes.flat:
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.grid(color="#e8e8e8", linewidth=0.6)
            panel.set_axisbelow(True)
        yield figure, axes.tolist()


def slope(panel: Axes, place: tuple[float, float], factor: int, power: int, label: str) -> None:
    """A dashed line of y ~ x^power over a factor in x, with its label at the end.

    place: where it begins, in x as a share of the panel's width, in y in units of the data. The limits must be set.
    """
    low, high = panel.get_xlim()
    x, y = low * (high / low) ** place[0], place[1]
    end = (x * factor, y * float(factor) ** power)
    panel.plot(
        (x, end[0]), (y, end[1]), color=GUIDE, linestyle=(0, (4, 3)), linewidth=1.1, zorder=1
    )
    panel.annotate(
        label,
        end,
        xytext=(3, 0),
        textcoords="offset points",
        color=GUIDE,
        fontsize=8.5,
        va="center",
    )


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write STEM.png and STEM.svg; returns both paths."""
    paths = [stem.with_suffix(".png"), stem.with_suffix(".svg")]
    figure.draw_without_rendering()
    # The layout takes as long as the drawing, and is the same for both.
    figure.set_layout_engine("none")
    for path in paths:
        with atomic(path) as part:
            metadata = {"Date": None} if path.suffix == ".svg" else None
            figure.savefig(part, dpi=DPI, metadata=metadata)
    return paths
