"""Figures of two panels over training time, average error and PSNR, with a legend below."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from nerfreg.analysis.figures import GUIDE, Style, panels, save, shortened
from nerfreg.reports.records import NamedRun, by_method, complete

Metric = Literal["average", "psnr"]
METRICS: dict[Metric, str] = {
    "average": "average error  (lower is better)",
    "psnr": "PSNR [dB]  (higher is better)",
}
"""The metrics of the two panels, and what their axes are called."""
PANEL = (3.45, 2.5)
"""Width and height of a panel in inches: a column of a paper."""
LEGEND_LENGTH = 80
TICKS = 6
FINE_TIMES = (
    1, 1.5, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40, 50, 60, 75, 90, 105, 120, 150, 180, 240,
    300, 360, 480, 600, 720, 900, 1200, 1500, 1800, 2400, 3000, 3600, 5400, 7200, 10800, 14400,
    18000, 28800, 36000, 54000, 86400,
)  # fmt: skip
TIMES = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000, 86400)


def draw_scores(
    runs: Sequence[NamedRun],
    styles: Mapping[str, Style],
    title: str,
    reading: str,
    stem: Path,
    draw: Callable[[Axes, Metric], list[float]],
) -> list[Path]:
    """Draw a figure, and write it as PNG and SVG.

    Args:
        runs: Of one setting; their methods stand in the legend.
        styles: Of every method.
        title: Stands above the panels.
        reading: How to read lines and markers, in the legend.
        stem: Path of the files without suffix.
        draw: Draws one metric into one panel, and returns all times at which there is something.
    """
    handles = [_handle(own, styles[method]) for method, own in by_method(runs).items()]
    columns = legend_columns([str(handle.get_label()) for handle in handles])
    height = PANEL[1] + 0.55 + 0.17 * math.ceil(len(handles) / columns)
    with panels(1, 2, 2 * PANEL[0], height, "linear", 8.5) as (figure, (axes,)):
        figure.suptitle(title)
        for panel, metric in zip(axes, METRICS, strict=True):
            seconds = draw(panel, metric)
            panel.set_ylabel(METRICS[metric])
            if seconds:
                _time_axis(panel, seconds)
            else:
                panel.text(0.5, 0.5, "no data", transform=panel.transAxes, ha="center", color=GUIDE)
                panel.set(xticks=[], yticks=[])
        place: dict[str, Any] = {"loc": "outside lower center", "ncols": columns, "frameon": False}
        legend = figure.legend(handles=handles, title=reading, **place)
        legend.get_title().set(color=GUIDE, fontsize=7.5)
        return save(figure, stem)


def legend_columns(names: Sequence[str]) -> int:
    """Return how many columns of names stand beside each other below two panels, 1 to 3."""
    width = 4.7 * max(map(len, names), default=0) + 36
    return max(1, min(3, int(144 * PANEL[0] / width)))


def time_ticks(low: float, high: float, most: int) -> list[float]:
    """Return at most so many round times between two; where there is none, one between them."""
    inside = [float(time) for time in TIMES if low <= time <= high]
    if len(inside) < 3:
        inside = [float(time) for time in FINE_TIMES if low <= time <= high]
    while len(inside) > most:
        inside = inside[::-2][::-1]
    return inside or [float(f"{math.sqrt(low * high):.2g}")]


def duration(seconds: float) -> str:
    """Return seconds as a reader would say them: 30 s, 10 min, 1.5 h."""
    if seconds < 60:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.3g} min" if seconds < 3600 else f"{seconds / 3600:.3g} h"


def _time_axis(panel: Axes, seconds: Sequence[float]) -> None:
    margin = math.exp(max(0.05 * math.log(max(seconds) / min(seconds)), 0.05))
    low, high = min(seconds) / margin, max(seconds) * margin
    ticks = time_ticks(low, high, TICKS)
    panel.set(xscale="log", xlim=(low, high), xlabel="training time")
    panel.set_xticks(ticks, [duration(tick) for tick in ticks])
    panel.set_xticks([], minor=True)


def _handle(runs: Sequence[NamedRun], style: Style) -> Line2D:
    seeds = len(complete(runs))
    count = f" ({seeds} seeds)" if seeds > 1 else "" if seeds else " (not complete)"
    handle = Line2D([], [], color=style.color, markeredgecolor="white", markeredgewidth=0.6)
    dash, marker = (style.dash, style.marker) if seeds else (":", ".")
    label = f"{shortened(style.label, LEGEND_LENGTH)}{count}"
    handle.set(linestyle=dash, marker=marker, label=label)
    return handle
