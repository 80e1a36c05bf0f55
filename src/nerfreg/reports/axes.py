"""Axes of training time with round ticks, and names beside points that keep apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from nerfreg.reports.style import PANEL

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PANEL_POINTS = 0.82 * 72 * PANEL[0]
"""Width of its axes in points (1/72 inch)."""
LABEL_OFFSET = 7
LABEL_LINE, LABEL_CHARACTER, LABEL_LENGTH = 12.5, 4.4, 24
"""A line's height (with what the axes of a panel take of its height) and a character's width in points; the longest."""
TICKS = 6
FINE_TIMES = (
    1, 1.5, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40, 50, 60, 75, 90, 105, 120, 150, 180, 240, 300, 360, 480, 600,
    720, 900, 1200, 1500, 1800, 2400, 3000, 3600, 5400, 7200, 10800, 14400, 18000, 28800, 36000, 54000, 86400,
)  # fmt: skip
TIMES = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000, 86400)


@dataclass(frozen=True)
class Label:
    """A name beside a point, in units of the data. raised: by so many lines above it."""

    text: str
    x: float
    y: float
    color: str
    raised: float = 0.0

    @property
    def short(self) -> str:
        """Not longer than a panel has room for."""
        return shortened(self.text, LABEL_LENGTH)

    @property
    def points(self) -> float:
        """Its width, with the distance to its point."""
        return LABEL_CHARACTER * len(self.short) + LABEL_OFFSET + 2


def time_axis(panel: Axes, seconds: Sequence[float], labels: Sequence[Label] = ()) -> None:
    """A logarithmic axis of training time over `seconds`, with round times as ticks, and room for labels."""
    low, high = math.log(min(seconds)), math.log(max(seconds))
    margin = max(0.05 * (high - low), 0.05)
    low, high = low - margin, high + margin
    room = _room([((math.log(label.x) - low) / (high - low), label) for label in labels])
    end = low + (high - low) / (1 - room)
    panel.set_xscale("log")
    panel.set_xlim(math.exp(low), math.exp(end))
    ticks = time_ticks(math.exp(low), math.exp(high), most=round(TICKS * (1 - room)))
    panel.set_xticks(ticks, [duration(tick) for tick in ticks])
    panel.set_xticks([], minor=True)
    panel.set_xlabel("training time")


def _room(labels: Sequence[tuple[float, Label]]) -> float:
    """The share of a panel that stays free on the right, for labels at places in [0, 1] of the rest; at most 0.6."""
    needed = [1 - (1 - label.points / PANEL_POINTS) / place for place, label in labels if place > 0]
    return min(max([0.0, *needed]), 0.6)


def time_ticks(low: float, high: float, most: int) -> list[float]:
    """At most so many round times between low and high (seconds); where there is none, one between them."""
    inside = [float(time) for time in TIMES if low <= time <= high]
    if len(inside) < 3:
        inside = [float(time) for time in FINE_TIMES if low <= time <= high]
    while len(inside) > max(most, 1):
        inside = inside[::-2][::-1]
    return inside or [float(f"{math.sqrt(low * high):.2g}")]


def duration(seconds: float) -> str:
    """Seconds as a reader would say them: 30 s, 10 min, 1.5 h."""
    if seconds < 60:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.3g} min" if seconds < 3600 else f"{seconds / 3600:.3g} h"


def shortened(text: str, length: int) -> str:
    """At most so many characters; what is left out is in the middle, for long names differ at their ends."""
    head = (length - 1) // 2
    return (
        text if len(text) <= length else f"{text[:head]}…{text[len(text) - (length - 1 - head) :]}"
    )


def separate(places: Sequence[float], gap: float) -> list[float]:
    """Move places apart until neighbours are `gap` from each other, keeping their order and, in a crowd, its middle.

    Crowds are merged from below (pool adjacent violators), which moves them by the least sum of squares.
    """
    order = sorted(range(len(places)), key=lambda index: places[index])
    crowds: list[tuple[float, list[int]]] = []  # middle, members
    for index in order:
        middle, members = places[index], [index]
        while crowds and middle - crowds[-1][0] < gap * (len(members) + len(crowds[-1][1])) / 2:
            below, others = crowds.pop()
            middle = (middle * len(members) + below * len(others)) / (len(members) + len(others))
            members = others + members
        crowds.append((middle, members))
    moved = list(places)
    for middle, members in crowds:
        for rank, index in enumerate(members):
            moved[index] = middle + gap * (rank - (len(members) - 1) / 2)
    return moved


def label_right(panel: Axes, labels: Sequence[Label], tall: float = PANEL[1]) -> None:
    """Names to the right of their points, moved apart where they would overlap.

    tall: height of the panel in inches, its axis included. The limits must be set; that of y grows if names need it.
    """
    from matplotlib.transforms import offset_copy

    beside = offset_copy(
        panel.transData, panel.get_figure(root=True), x=LABEL_OFFSET, units="points"
    )
    for column in _columns(panel, labels):
        for _ in range(2):  # again, since a longer axis makes lines taller
            low, high = panel.get_ylim()
            line = LABEL_LINE / (72 * tall) * (high - low)
            heights = separate([label.y + label.raised * line for label in column], line)
            panel.set_ylim(min(low, min(heights) - line / 2), max(high, max(heights) + line / 2))
        for label, height in zip(column, heights, strict=True):
            leader = {
                "arrowstyle": "-",
                "color": label.color,
                "linewidth": 0.5,
                "shrinkA": 0,
                "shrinkB": 3,
                "relpos": (0, 0.5),
            }
            panel.annotate(
                label.short,
                (label.x, label.y),
                xytext=(label.x, height),
                textcoords=beside,
                color=label.color,
                fontsize=7.5,
                va="center",
                arrowprops=leader
                if abs(height - label.y) > line * (0.5 + abs(label.raised))
                else None,
            ).set_in_layout(False)


def _columns(panel: Axes, labels: Sequence[Label]) -> list[list[Label]]:
    """Labels that have others above or below them, together."""
    columns: list[list[Label]] = []
    end = -math.inf
    low, high = map(math.log, panel.get_xlim())
    for label in sorted(labels, key=lambda label: label.x):
        left = (math.log(label.x) - low) / (high - low) * PANEL_POINTS
        if left > end:
            columns.append([])
        columns[-1].append(label)
        end = max(end, left + label.points)
    return columns
