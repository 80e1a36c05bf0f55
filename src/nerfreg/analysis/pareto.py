"""Which methods nobody beats: final error against the time it took, and the front of those that are best at theirs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from nerfreg.reports.axes import Label, label_right, time_axis
from nerfreg.reports.curves import LABELS, Metric, Point, final_point
from nerfreg.reports.grouping import by_method
from nerfreg.reports.records import RunRecord
from nerfreg.reports.style import FAINT, GUIDE, INK, PANEL, Style, panels, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NAMES = 16
"""As many methods have their names beside them: those of the front, and the best of the others."""


def front(costs: Sequence[tuple[float | None, float | None]]) -> list[int]:
    """Indices of the points that no other dominates, in the order of the first cost; smaller is better in both.

    A point dominates another if it is nowhere worse and somewhere better: equal points are on the front together. A
    point with a cost that is unknown or not finite is not on it.
    """
    known = [
        (first, second, index)
        for index, (first, second) in enumerate(costs)
        if first is not None
        and second is not None
        and math.isfinite(first)
        and math.isfinite(second)
    ]
    chosen: list[tuple[float, float, int]] = []
    for first, second, index in sorted(known):
        if not chosen or second < chosen[-1][1] or (first, second) == chosen[-1][:2]:
            chosen.append((first, second, index))
    return [index for _, _, index in chosen]


def draw_pareto(
    runs: Sequence[RunRecord], styles: Mapping[str, Style], title: str, stem: Path
) -> list[Path]:
    """Final average error and PSNR against training time for the methods of one setting; PNG and SVG.

    The front is a step line; what lies behind it is faint. Bars: smallest to largest over seeds.
    """
    methods = by_method(runs)
    tall = max(PANEL[1], 0.7 + 0.155 * min(len(methods), NAMES))
    with panels(2, 2 * PANEL[0], tall + 0.2) as (figure, axes):
        for panel, metric in zip(axes, LABELS, strict=True):
            points = {method: final_point(own, metric) for method, own in methods.items()}
            _draw_panel(
                panel,
                {method: point for method, point in points.items() if point},
                styles,
                metric,
                tall,
            )
        figure.suptitle(title, fontsize=9.5, color=INK)
        return save(figure, stem)


def _draw_panel(
    panel: Axes,
    points: Mapping[str, Point],
    styles: Mapping[str, Style],
    metric: Metric,
    tall: float,
) -> None:
    panel.set_ylabel(LABELS[metric])
    if not points:
        panel.text(0.5, 0.5, "no complete run", transform=panel.transAxes, ha="center", color=GUIDE)
        panel.set_xticks([])
        panel.set_yticks([])
        return
    sign = -1 if metric == "psnr" else 1
    names = sorted(points, key=lambda method: sign * points[method].value)
    best = [
        names[index]
        for index in front([(points[name].seconds, sign * points[name].value) for name in names])
    ]
    named = {*best, *names[: max(NAMES - len(best), 0)]}
    labels: list[Label] = []
    for method, point in points.items():
        leads = method in best
        color = (
            styles[method].color
            if leads and not styles[method].faint
            else GUIDE
            if leads
            else FAINT
        )
        spread = (
            [[point.value - point.low], [point.high - point.value]]
            if point.high > point.low
            else None
        )
        panel.errorbar(
            point.seconds, point.value, spread, fmt=styles[method].marker, color=color, markeredgecolor="white",
            markeredgewidth=0.6, elinewidth=0.9, capsize=1.5, zorder=4 if leads else 3,
        )  # fmt: skip
        raised = (
            0.8 * sign if leads and method != best[-1] else 0.0
        )  # off the line that goes on to the right
        if method not in named:
            continue
        labels.append(Label(method, point.seconds, point.value, INK if leads else GUIDE, raised))
    line = [points[method] for method in best]
    panel.step(
        [point.seconds for point in line], [point.value for point in line], where="post", color=GUIDE, linewidth=1,
        linestyle=(0, (3, 2)), zorder=2,
    )  # fmt: skip
    time_axis(panel, [point.seconds for point in points.values()], labels)
    label_right(panel, labels, tall)
