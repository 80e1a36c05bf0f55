"""Figures of curves on logarithmic axes, from numbers alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from nerfreg.analysis.figures import panels, save, styles

Curve = tuple[Sequence[float], Sequence[float]]
"""x and y of its points."""


@dataclass(frozen=True)
class CurvePanel:
    """A panel of a figure.

    Attributes:
        curves: By label; one label has one colour and one marker in the whole figure.
        title: Above the panel.
        xlabel: Below it.
        ylabel: To its left, if it is the first of its row.
    """

    curves: Mapping[str, Curve]
    title: str = ""
    xlabel: str = ""
    ylabel: str = ""


def draw_curves(
    stem: Path,
    rows: Sequence[Sequence[CurvePanel]],
    title: str,
    size: tuple[float, float],
    xbase: int = 10,
) -> list[Path]:
    """Draw panels with one legend, those of a row with the same y, as STEM.png and STEM.svg.

    Args:
        stem: Path of the files without their ending.
        rows: Panels from left to right, as many in each row.
        title: Above all panels.
        size: Width and height in inches.
        xbase: Base of the ticks of x.

    Returns:
        The paths of both files.
    """
    labels = dict.fromkeys(label for row in rows for panel in row for label in panel.curves)
    named = {style.label: style for style in styles(tuple(labels))}
    with panels(len(rows), len(rows[0]), *size) as (figure, axes):
        handles = {}
        for row, axes_of_row in zip(rows, axes, strict=True):
            values = [
                value for panel in row for curve in panel.curves.values() for value in curve[1]
            ]
            for panel, ax in zip(row, axes_of_row, strict=True):
                for label, (x, y) in panel.curves.items():
                    look = {"color": named[label].color, "marker": named[label].marker}
                    handles[label] = ax.plot(x, y, label=label, markeredgewidth=0, **look)[0]
                ax.set(
                    title=panel.title, xlabel=panel.xlabel, ylim=(min(values) / 2, max(values) * 2)
                )
                ax.set_xscale("log", base=xbase)
                ax.tick_params(labelleft=False)
            axes_of_row[0].set_ylabel(row[0].ylabel)
            axes_of_row[0].tick_params(labelleft=True)
        figure.suptitle(title, fontsize=11.5)
        place, columns = "outside lower center", len(handles)
        figure.legend(handles.values(), handles, loc=place, ncols=columns, frameon=False)
        return save(figure, stem)
