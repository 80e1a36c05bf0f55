"""Figures of curves on logarithmic axes, from points that say where they belong."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from statistics import median
from typing import NamedTuple

from nerfreg.analysis.figures import panels, save, styles


class Dot(NamedTuple):
    """A point of a figure.

    Attributes:
        row: Row of panels that it lies in; the label of their y.
        column: Column of panels; their title.
        curve: The curve that it is part of; its label in the legend.
        x: Above 0; points that are not are left out.
        y: Of dots that differ in nothing else, the median is drawn.
    """

    row: str
    column: str
    curve: str
    x: float
    y: float


def draw_curves(
    stem: Path,
    dots: Iterable[Dot],
    title: str,
    size: tuple[float, float],
    xlabel: str = "",
    span: tuple[float, float] = (0.0, math.inf),
) -> list[Path]:
    """Draw curves in panels that share y in each row, as STEM.png and STEM.svg.

    Args:
        stem: Path of the files without their ending.
        dots: Rows, columns and curves stand in the order in which they first appear.
        title: Above all panels.
        size: Width and height in inches.
        xlabel: Below the lowest row.
        span: y outside is drawn at the end of the span.

    Returns:
        The paths of both files.
    """
    values: dict[tuple[str, str, str], dict[float, list[float]]] = {}
    for row, column, curve, x, y in dots:
        if x > 0:
            of_x = values.setdefault((row, column, curve), {}).setdefault(x, [])
            of_x.append(min(max(y, span[0]), span[1]))
    rows, columns, curves = (list(dict.fromkeys(names)) for names in zip(*values, strict=True))
    named = dict(zip(curves, styles(curves), strict=True))
    with panels(len(rows), len(columns), *size) as (figure, axes):
        for (row, column, curve), points in values.items():
            panel, style = axes[rows.index(row)][columns.index(column)], named[curve]
            medians = [median(of_x) for of_x in points.values()]
            panel.plot(
                list(points),
                medians,
                color=style.color,
                marker=style.marker,
                label=curve,
                markeredgewidth=0,
            )
        for row, panels_of_row in zip(rows, axes, strict=True):
            limits = [panel.get_ylim() for panel in panels_of_row]
            panels_of_row[0].set_ylabel(row)
            for panel in panels_of_row:
                panel.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
                panel.tick_params(which="both", labelleft=panel is panels_of_row[0])
                panel.set_xscale("log", base=2)
                panel.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        for index, column in enumerate(columns):
            axes[0][index].set_title(column)
            axes[-1][index].set_xlabel(xlabel)
        figure.suptitle(title, fontsize=11.5)
        lines = {line.get_label(): line for row in axes for ax in row for line in ax.get_lines()}
        handles = [lines[curve] for curve in curves]
        figure.legend(handles, curves, loc="outside lower center", ncols=4, frameon=False)
        return save(figure, stem)
