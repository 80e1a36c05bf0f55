"""Error against run time: how scores change while methods train, and which methods nobody beats."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from nerfreg.analysis.figures import GUIDE, Style, styles
from nerfreg.analysis.pareto import front
from nerfreg.reports.axes import PANEL, Metric, draw_scores
from nerfreg.reports.paper import PaperRow, published
from nerfreg.reports.records import NamedRun, by_method, by_setting, complete
from nerfreg.runs.records import EvaluationRecord

PUBLISHED_LINE = 9.0
"""Height of the name of a published number in points, with what the axes take."""
CURVES = (
    "lines: some of the test views, mean and range over seeds; markers: all test views, at the end"
)
PARETO = (
    "all test views at the end, mean and range over seeds; dashed: nothing is better and faster"
)

Points = Float[np.ndarray, "_ 2"]
"""Seconds of training and a metric, in the order of time; all seconds > 0, all values known."""


def points(evaluations: Iterable[EvaluationRecord], metric: Metric) -> Points:
    """Return what there is to draw of a metric."""
    known = [(each.train_seconds, getattr(each, metric)) for each in evaluations]
    known = [(x, y) for x, y in known if x > 0 and y is not None and math.isfinite(y)]
    return np.array(known, dtype=float).reshape(-1, 2)


def curve(run: NamedRun, metric: Metric) -> Points:
    """Return what a run's curve goes through: evaluations on a part of the test views.

    Where there are none, all evaluations. The two are not mixed, since another choice of views
    scores differently.
    """
    partial_views = [each for each in run.evaluations if not each.whole]
    return points(partial_views or run.evaluations, metric)


def finals(runs: Iterable[NamedRun], metric: Metric) -> Points:
    """Return the final scores of all test views, of the runs that have them."""
    return points((run.final for run in runs if run.final), metric)


def band(curves: Sequence[Points]) -> Float[np.ndarray, "4 times"] | None:
    """Return times at which all seeds have data, and mean, smallest and largest value at these.

    Between evaluations values are linear in the logarithm of time. None: there are not two times.
    """
    if not curves or not all(map(len, curves)):
        return None
    first, last = max(each[0, 0] for each in curves), min(each[-1, 0] for each in curves)
    seconds = np.unique(np.concatenate([each[:, 0] for each in curves]))
    seconds = seconds[(first <= seconds) & (seconds <= last)]
    if len(seconds) < 2:
        return None
    times = np.log(seconds)
    values = np.stack([np.interp(times, np.log(each[:, 0]), each[:, 1]) for each in curves])
    return np.stack([seconds, values.mean(0), values.min(0), values.max(0)])


def draw_figures(runs: Sequence[NamedRun], paper: Sequence[PaperRow], folder: Path) -> list[Path]:
    """Draw the curves of every setting, and the front of several methods, as PNG and SVG.

    A method has the same colour in all of them. Published numbers stand in the curves as lines.

    Raises:
        NerfregError: A file cannot be written.
    """
    looks = {style.label: style for style in styles(list(by_method(runs)))}
    paths = []
    for setting, own in by_setting(runs).items():
        title, ended = setting.title, complete(own)
        if any(run.evaluations for run in own):
            rows, _ = published(paper, setting, own[0].settings)
            paths += draw_curves(own, looks, title, folder / f"curves-{setting.name}", rows)
        if len(by_method(ended)) > 1:
            paths += draw_pareto(ended, looks, title, folder / f"pareto-{setting.name}")
    return paths


def draw_curves(
    runs: Sequence[NamedRun],
    styles: Mapping[str, Style],
    title: str,
    stem: Path,
    paper: Sequence[PaperRow] = (),
) -> list[Path]:
    """Draw average error and PSNR over training time for the methods of one setting.

    Lines: mean over seeds on a part of the test views, with a band from the smallest to the
    largest. Markers: all test views at the end. Thin dotted lines: runs that are not complete.
    Level lines: what was published.
    """

    def draw(panel: Axes, metric: Metric) -> list[float]:
        seconds: list[float] = []
        for method, own in by_method(runs).items():
            seconds += _draw_method(panel, own, styles[method], metric)
        if seconds:
            _draw_published(panel, paper, metric)
        return seconds

    return draw_scores(runs, styles, title, CURVES, stem, draw)


def draw_pareto(
    runs: Sequence[NamedRun], styles: Mapping[str, Style], title: str, stem: Path
) -> list[Path]:
    """Draw final scores against training time, and their front as a step line, as PNG and SVG."""

    def draw(panel: Axes, metric: Metric) -> list[float]:
        sign = -1 if metric == "psnr" else 1
        found = {method: finals(own, metric) for method, own in by_method(runs).items()}
        marks = [_mark(panel, own, styles[method]) for method, own in found.items() if len(own)]
        best = [marks[index] for index in front([(x, sign * y) for x, y in marks])]
        look: dict[str, Any] = {"color": GUIDE, "linewidth": 1, "linestyle": (0, (3, 2))}
        panel.step([x for x, _ in best], [y for _, y in best], where="post", zorder=2, **look)
        return [x for x, _ in marks]

    return draw_scores(runs, styles, title, PARETO, stem, draw)


def _draw_method(
    panel: Axes, runs: Sequence[NamedRun], style: Style, metric: Metric
) -> list[float]:
    """Draw what a method has, and return all times at which there is something."""
    ended = [curve(run, metric) for run in complete(runs)]
    loose = [curve(run, metric) for run in runs if run.final is None]
    common = band(ended)
    if common is None:
        loose += ended
    else:
        x, mean, low, high = common
        panel.plot(x, mean, color=style.color, linestyle=style.dash, zorder=3)
        if len(ended) > 1:
            area: dict[str, Any] = {"alpha": 0.16, "linewidth": 0, "zorder": 2}
            panel.fill_between(x, low, high, color=style.color, **area)
    for each in loose:
        look: dict[str, Any] = {"linestyle": ":", "linewidth": 1, "marker": ".", "markersize": 3}
        panel.plot(each[:, 0], each[:, 1], color=style.color, **look)
    scores = finals(runs, metric)
    seconds = [_mark(panel, scores, style)[0]] if len(scores) else []
    seconds += [] if common is None else common[0].tolist()
    return seconds + [time for each in loose for time in each[:, 0].tolist()]


def _mark(panel: Axes, scores: Points, style: Style) -> tuple[float, float]:
    """Draw a method's final scores as a marker, their range over seeds as a bar."""
    x, y = map(statistics.fmean, scores.T.tolist())
    low, high = scores[:, 1].min(), scores[:, 1].max()
    bar = [[y - low], [high - y]] if high > low else None
    look: dict[str, Any] = {"fmt": style.marker, "color": style.color, "markeredgecolor": "white"}
    panel.errorbar(x, y, bar, **look, markeredgewidth=0.6, elinewidth=1, capsize=2, zorder=5)
    return x, y


def _draw_published(panel: Axes, paper: Sequence[PaperRow], metric: Metric) -> None:
    """Draw a level line for each row; the axis grows to show them all.

    Names stand above the lines on the left, those of lines too close for that together.
    """
    known = sorted((v, row.method) for row in paper if (v := getattr(row, metric)) is not None)
    if not known:
        return
    for value, _ in known:
        panel.axhline(value, color=GUIDE, linewidth=0.7, linestyle=(0, (1, 1.5)), zorder=1)
    low, high = panel.get_ylim()
    lowest, highest = known[0][0], known[-1][0]
    room = PUBLISHED_LINE / (72 * PANEL[1]) * (max(high, highest) - min(low, lowest))
    panel.set_ylim(min(low, lowest - room / 2), max(high, highest + room))
    write = partial(panel.text, transform=panel.get_yaxis_transform(), color=GUIDE, fontsize=6)
    names: list[str] = []
    above = [value for value, _ in known[1:]]
    for (value, method), following in zip(known, [*above, math.inf], strict=True):
        names.insert(0, method)
        if following - value >= room:
            text = write(0.015, value + room / 2, f"{', '.join(names)} (paper)", va="center")
            text.set_in_layout(False)
            names = []
