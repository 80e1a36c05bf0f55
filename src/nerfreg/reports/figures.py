"""The figures of a report: error against run time, and the Pareto front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from nerfreg.analysis.figures import styles
from nerfreg.reports.curves import draw_curves, draw_pareto
from nerfreg.reports.paper import PaperRow, published
from nerfreg.reports.records import RunRecord, by_method, by_setting, complete


@dataclass(frozen=True)
class DrawnFigure:
    """A figure: what it shows, of which setting, and its files, a PNG and an SVG."""

    kind: Literal["curves", "pareto"]
    title: str
    paths: list[Path]


def draw_figures(
    runs: Sequence[RunRecord], paper: Sequence[PaperRow], folder: Path
) -> list[DrawnFigure]:
    """Draw the curves of every setting, and the front of several methods.

    Args:
        runs: Of all settings. A method has the same colour in all of them.
        paper: Published numbers, which stand in the curves as lines.
        folder: Where the files go.

    Raises:
        NerfregError: A file cannot be written.
    """
    looks = {style.label: style for style in styles(list(by_method(runs)))}
    drawn = []
    for setting, own in by_setting(runs).items():
        title = setting.title
        if any(run.evaluations for run in own):
            rows, _ = published(paper, setting, own[0].settings)
            paths = draw_curves(own, looks, title, folder / f"curves-{setting.name}", rows)
            drawn.append(DrawnFigure("curves", title, paths))
        ended = complete(own)
        if len(by_method(ended)) > 1:
            paths = draw_pareto(ended, looks, title, folder / f"pareto-{setting.name}")
            drawn.append(DrawnFigure("pareto", title, paths))
    return drawn
