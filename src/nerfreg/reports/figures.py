"""The figures of a report: error against run time, and the Pareto front."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nerfreg.analysis.figures import styles
from nerfreg.reports.curves import draw_curves, draw_pareto
from nerfreg.reports.paper import PaperRow, published
from nerfreg.reports.records import NamedRun, by_method, by_setting, complete


def draw_figures(runs: Sequence[NamedRun], paper: Sequence[PaperRow], folder: Path) -> list[Path]:
    """Draw the curves of every setting, and the front of several methods, as PNG and SVG.

    Args:
        runs: Of all settings. A method has the same colour in all of them.
        paper: Published numbers, which stand in the curves as lines.
        folder: Where the files go: curves-SETTING and pareto-SETTING.

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
