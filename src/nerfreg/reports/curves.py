"""Error against run time: how scores change while a method trains, with the spread over its seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float

from nerfreg.reports.axes import LABEL_CHARACTER, Label, label_right, shortened, time_axis
from nerfreg.reports.methods import VANILLA
from nerfreg.reports.paper import PaperRow, with_average
from nerfreg.reports.records import Evaluation, RunRecord
from nerfreg.reports.statistics import ordered_methods
from nerfreg.reports.style import GUIDE, INK, PANEL, Style, panels, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Metric = Literal["average", "psnr"]
LABELS: dict[Metric, str] = {
    "average": "average error  (lower is better)",
    "psnr": "PSNR [dB]  (higher is better)",
}

LEGEND_LENGTH = 80
NAMES = 6
"""As many of the methods without colour, the best, have their names beside them."""
PUBLISHED_LINE = 9.0
"""Height of the name of a published number in points, with what the axes take."""
READING = (
    "lines: some of the test views, mean and range over seeds; markers: all test views, at the end"
)


@dataclass(frozen=True)
class Series:
    """A metric over seconds of training, in the order of time; all seconds > 0, all values known."""

    seconds: tuple[float, ...]
    values: tuple[float, ...]


@dataclass(frozen=True)
class Band:
    """Mean, smallest and largest over seeds at common times."""

    seconds: Float[np.ndarray, " times"]
    mean: Float[np.ndarray, " times"]
    low: Float[np.ndarray, " times"]
    high: Float[np.ndarray, " times"]


@dataclass(frozen=True)
class Point:
    """Final scores over seeds: means, and the smallest and largest value."""

    seconds: float
    value: float
    low: float
    high: float


def series(run: RunRecord, metric: Metric) -> Series:
    """What a run's curve goes through: evaluations of one kind, since another choice of views scores differently.

    That is those on a part of the test views where there are any, else those on all of them.
    """
    partial = [each for each in run.evaluations if not each.whole]
    known = [
        (each.train_seconds, value)
        for each in partial or run.evaluations
        if (value := value_of(each, metric)) is not None and each.train_seconds > 0
    ]
    return Series(tuple(seconds for seconds, _ in known), tuple(value for _, value in known))


def band(group: Sequence[Series]) -> Band | None:
    """Mean and extremes over seeds, where all of them have data; between evaluations linear in log time.

    None where no two times are common to all.
    """
    if not group or not all(each.seconds for each in group):
        return None
    first = max(each.seconds[0] for each in group)
    last = min(each.seconds[-1] for each in group)
    seconds = np.unique([time for each in group for time in each.seconds if first <= time <= last])
    if len(seconds) < 2:
        return None
    values = np.stack(
        [np.interp(np.log(seconds), np.log(each.seconds), each.values) for each in group]
    )
    return Band(seconds, values.mean(0), values.min(0), values.max(0))


def final_point(runs: Sequence[RunRecord], metric: Metric) -> Point | None:
    """Final scores over seeds, of the runs that have them."""
    known = [
        (run.final.train_seconds, value)
        for run in runs
        if run.final is not None
        and (value := value_of(run.final, metric)) is not None
        and run.final.train_seconds > 0
    ]
    if not known:
        return None
    times, values = zip(*known, strict=True)
    return Point(sum(times) / len(times), sum(values) / len(values), min(values), max(values))


def value_of(evaluation: Evaluation, metric: Metric) -> float | None:
    """A metric of an evaluation; None also where it is not finite."""
    value = evaluation.average if metric == "average" else evaluation.psnr
    return value if value is not None and math.isfinite(value) else None


def draw_curves(
    runs: Sequence[RunRecord],
    styles: Mapping[str, Style],
    title: str,
    stem: Path,
    published: Sequence[PaperRow] = (),
) -> list[Path]:
    """Average error and PSNR over training time for the methods of one setting; PNG and SVG.

    Lines: mean over seeds on a part of the test views, with a band from the smallest to the largest. Markers: all
    test views at the end. Thin dotted lines: runs that are not complete. Level lines: what was published.
    """
    methods = ordered_methods(runs, VANILLA)
    keys = [method for method in methods if not styles[method].faint]
    handles = [_handle(methods[method], styles[method], method) for method in keys]
    columns = legend_columns([handle.get_label() for handle in handles])
    rows = math.ceil(len(keys) / columns)
    with panels(2, 2 * PANEL[0], PANEL[1] + 0.55 + 0.17 * rows) as (figure, axes):
        for panel, metric in zip(axes, LABELS, strict=True):
            _draw_panel(panel, methods, styles, metric)
            _draw_published(panel, published, metric)
        figure.suptitle(title, fontsize=9.5, color=INK)
        if handles:
            legend = figure.legend(
                handles=handles,
                loc="outside lower center",
                ncols=columns,
                frameon=False,
                title=READING,
            )
            legend.get_title().set(color=GUIDE, fontsize=7.5)
        return save(figure, stem)


def _draw_panel(
    panel: Axes, methods: Mapping[str, list[RunRecord]], styles: Mapping[str, Style], metric: Metric
) -> None:
    names: list[Label] = []
    seconds: list[float] = []
    for method, runs in methods.items():
        style = styles[method]
        drawn = _draw_method(panel, runs, style, metric)
        seconds += [x for x, _ in drawn]
        if style.faint and drawn:
            names.append(Label(method, *drawn[-1], color=GUIDE))
    panel.set_ylabel(LABELS[metric])
    if not seconds:
        panel.text(0.5, 0.5, "no data", transform=panel.transAxes, ha="center", color=GUIDE)
        panel.set_xticks([])
        panel.set_yticks([])
        return
    names.sort(key=lambda name: name.y, reverse=metric == "psnr")
    time_axis(panel, seconds, names[:NAMES])
    label_right(panel, names[:NAMES])


def _draw_published(panel: Axes, published: Sequence[PaperRow], metric: Metric) -> None:
    """A level line for each row. Names stand above it on the left, those of lines too close for that together.

    The axis grows to show them all.
    """
    known = sorted(
        (value, row.method)
        for row in map(with_average, published)
        if (value := getattr(row, metric)) is not None
    )
    if not panel.get_xticks().size or not known:
        return
    for value, _ in known:
        panel.axhline(value, color=GUIDE, linewidth=0.7, linestyle=(0, (1, 1.5)), zorder=1)
    low, high = panel.get_ylim()
    lowest, highest = known[0][0], known[-1][0]
    room = PUBLISHED_LINE / (72 * PANEL[1]) * (max(high, highest) - min(low, lowest))
    panel.set_ylim(min(low, lowest - room / 2), max(high, highest + room))
    names: list[str] = []
    for index, (value, method) in enumerate(known):
        names.insert(0, method)
        above = known[index + 1][0] if index + 1 < len(known) else math.inf
        if above - value >= room:
            panel.text(
                0.015, value + room / 2, f"{', '.join(names)} (paper)", transform=panel.get_yaxis_transform(),
                color=GUIDE, fontsize=6, va="center",
            ).set_in_layout(False)  # fmt: skip
            names = []


def _draw_method(
    panel: Axes, runs: Sequence[RunRecord], style: Style, metric: Metric
) -> list[tuple[float, float]]:
    """Draw what a method has; returns points that it goes through, the last of them where its name may stand."""
    order = 2 if style.faint else 3
    complete = [series(run, metric) for run in runs if run.final is not None]
    loose = [series(run, metric) for run in runs if run.final is None]
    drawn: list[tuple[float, float]] = []
    common = band(complete)
    if common is None:
        loose += complete
    else:
        panel.plot(
            common.seconds, common.mean, color=style.color, linestyle=style.dash, zorder=order
        )
        if len(complete) > 1 and not style.faint:
            panel.fill_between(
                common.seconds,
                common.low,
                common.high,
                color=style.color,
                alpha=0.16,
                linewidth=0,
                zorder=order - 1,
            )
        drawn += zip(common.seconds.tolist(), common.mean.tolist(), strict=True)
    for each in loose:
        panel.plot(
            each.seconds,
            each.values,
            color=style.color,
            linestyle=":",
            linewidth=1,
            marker=".",
            markersize=3,
        )
        drawn += zip(each.seconds, each.values, strict=True)
    point = final_point(runs, metric)
    if point is not None:
        spread = [[point.value - point.low], [point.high - point.value]]
        panel.errorbar(
            point.seconds, point.value, spread if point.high > point.low else None, fmt=style.marker, color=style.color,
            markeredgecolor="white", markeredgewidth=0.6, elinewidth=1, capsize=2, zorder=order + 2,
        )  # fmt: skip
        drawn.append((point.seconds, point.value))
    return drawn


def legend_columns(names: Sequence[str]) -> int:
    """As many columns of names as stand beside each other below two panels, 1 to 3."""
    width = LABEL_CHARACTER * 1.07 * max(map(len, names), default=0) + 36
    return max(1, min(3, int(144 * PANEL[0] / width)))


def _handle(runs: Sequence[RunRecord], style: Style, method: str) -> Any:
    from matplotlib.lines import Line2D

    seeds = sum(run.final is not None for run in runs)
    count = f" ({seeds} seeds)" if seeds > 1 else "" if seeds else " (not complete)"
    return Line2D(
        [], [], color=style.color, linestyle=style.dash if seeds else ":", marker=style.marker if seeds else ".",
        markeredgecolor="white", markeredgewidth=0.6, label=f"{shortened(method, LEGEND_LENGTH)}{count}",
    )  # fmt: skip
