"""The figures of a report, as files: error against run time, the Pareto front, the cost of regularizers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from nerfreg.analysis.pareto import draw_pareto
from nerfreg.reports.costs import draw_costs
from nerfreg.reports.curves import draw_curves
from nerfreg.reports.grouping import by_method, by_setting
from nerfreg.reports.paper import PaperRow, published
from nerfreg.reports.records import RunRecord
from nerfreg.reports.style import COLORED, method_styles
from nerfreg.reports.timing import costs

Kind = Literal["curves", "pareto", "cost"]


@dataclass(frozen=True)
class Plot:
    """name: of its files, without suffix. title: what it shows of which scene. draw: writes them beside each other."""

    kind: Kind
    name: str
    title: str
    draw: Callable[[Path], list[Path]]


def plots(records: Sequence[RunRecord], paper: Sequence[PaperRow] = ()) -> list[Plot]:
    """What there is to draw: for every scene the curves, the front of more than one method, and what a step costs.

    paper: published numbers, which stand in the curves as lines.
    """
    few = len(by_method(records)) <= COLORED
    found: list[Plot] = []
    for setting, runs in by_setting(records).items():
        styles = method_styles(
            records if few else runs
        )  # few enough to have the same colours in all scenes
        scored = [run for run in runs if run.evaluations or run.final is not None]
        if scored:
            rows, _ = published(paper, setting, runs)
            draw = partial(draw_curves, scored, styles, setting.title, published=rows)
            found.append(Plot("curves", f"curves-{setting.name}", setting.title, draw))
        complete = [run for run in runs if run.final is not None]
        if len({run.method for run in complete}) > 1:
            draw = partial(draw_pareto, complete, styles, setting.title)
            found.append(Plot("pareto", f"pareto-{setting.name}", setting.title, draw))
        timed = [cost for cost in costs(complete) if cost.relative is not None]
        if len({cost.method for cost in timed}) > 1:
            draw = partial(draw_costs, timed, setting.title)
            found.append(Plot("cost", f"cost-{setting.name}", setting.title, draw))
    return found


def draw(figures: Sequence[Plot], folder: Path) -> list[Path]:
    """Draw figures into a folder, PNG and SVG of each. Raises NerfregError where they cannot be written."""
    return [path for plot in figures for path in plot.draw(folder / plot.name)]
