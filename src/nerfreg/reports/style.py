"""How the figures of a report look: a style for each method, panels, files."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nerfreg.files import atomic
from nerfreg.reports.methods import VANILLA
from nerfreg.reports.records import RunRecord
from nerfreg.reports.statistics import ordered_methods

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Of Okabe and Ito (2008): told apart by all kinds of colour vision. Without black and yellow, which vanish on a dark
and on a light page."""
MARKERS = ("o", "s", "^", "D", "v", "p", "<", ">", "h", "d")
DASHES: tuple[Any, ...] = ("solid", (0, (5, 1.6)))
INK, GUIDE, FAINT, GRID = "#1b1f24", "#6b7280", "#a3a9b2", "#e4e6e9"
"""Text and axes; notes; methods without a colour of their own; grid. A page replaces each by its own."""
COLORED = 10
"""As many methods have a colour of their own; the others are grey, with their names beside them."""
DPI = 200
PANEL = (3.45, 2.5)
"""Width and height of a panel in inches: a column of a paper."""


@dataclass(frozen=True)
class Style:
    """How a method is drawn. faint: it has no colour of its own."""

    color: str
    dash: Any
    marker: str
    faint: bool = False


def method_styles(records: Sequence[RunRecord]) -> dict[str, Style]:
    """A style for every method; of many, colours go to `vanilla` and to the best.

    Best by the mean of final PSNR over all runs; a method without one comes last.
    """
    methods = ordered_methods(records, VANILLA)
    ranked = sorted(methods, key=lambda method: (method != VANILLA, -_mean_psnr(methods[method])))
    chosen = set(ranked[:COLORED])
    styles, index = dict[str, Style](), 0
    for method in methods:
        if method in chosen:
            dash = DASHES[index // len(PALETTE) % len(DASHES)]
            styles[method] = Style(
                PALETTE[index % len(PALETTE)], dash, MARKERS[index % len(MARKERS)]
            )
            index += 1
        else:
            styles[method] = Style(FAINT, "solid", "o", faint=True)
    return styles


def _mean_psnr(runs: Sequence[RunRecord]) -> float:
    known = [run.final.psnr for run in runs if run.final is not None and run.final.psnr is not None]
    return sum(known) / len(known) if known else -math.inf


@contextmanager
def panels(columns: int, width: float, height: float) -> Iterator[tuple[Figure, list[Axes]]]:
    """A figure of panels in a row, its size in inches, in the style of all reports, which holds inside the block."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    style: Any = {
        "font.size": 8.5,
        "axes.titlesize": 9,
        "axes.labelsize": 8.5,
        "xtick.labelsize": 8,
        "ytick.labelsize": 8,
        "legend.fontsize": 8,
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
        "figure.facecolor": "none",
        "lines.linewidth": 1.5,
        "lines.markersize": 5.0,
        "svg.fonttype": "none",
        "svg.hashsalt": "nerfreg",
    }
    with rc_context(style):
        figure = Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.07))
        axes = figure.subplots(1, columns, squeeze=False)[0].tolist()
        for panel in axes:
            panel.grid(color=GRID, linewidth=0.6)
            panel.set_axisbelow(True)
        yield figure, axes


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write STEM.png on white and STEM.svg without a background; returns both paths."""
    figure.draw_without_rendering()
    # The layout takes as long as the drawing, and is the same for both.
    figure.set_layout_engine("none")
    paths = [stem.with_name(f"{stem.name}{suffix}") for suffix in (".png", ".svg")]
    for path in paths:
        vector = path.suffix == ".svg"
        with atomic(path) as part:
            metadata = {"Date": None} if vector else None
            figure.savefig(
                part, dpi=DPI, metadata=metadata, facecolor="none" if vector else "white"
            )
    return paths
