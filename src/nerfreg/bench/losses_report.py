"""What `nerfreg bench losses` shows of its points: a table and a plot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median
from textwrap import wrap
from typing import TYPE_CHECKING

from rich.console import Console

from nerfreg.analysis.figures import GUIDE, Style, panels, save, slope, styles
from nerfreg.analysis.tables import new_table
from nerfreg.bench.inputs import INPUTS
from nerfreg.bench.losses import PLUGIN, Point, Sizes
from nerfreg.bench.rivals import RIVALS
from nerfreg.bench.timing import CONDITIONS

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

LOWEST, HIGHEST = 1e-9, 1e3
ROUNDING = 2.0**-24


def print_table(points: Sequence[Point], left_out: Sequence[str], sizes: Sizes) -> None:
    """For each form the worst error on each input, over all sizes, and its run time at the largest size it was run."""
    caption = (
        f"Worst relative error in float32 over {sizes.samples[0]} to {sizes.samples[-1]} samples, "
        f"on {sizes.exact_rays} rays. Times: forward and backward on {sizes.rays} rays at the most samples that the "
        f"form was run with; {CONDITIONS.format(repetitions=sizes.repetitions)}."
    )
    if left_out:
        caption += (
            f" Without a term of a rendering alone, or without exact values: {', '.join(left_out)}."
        )
    table = new_table("Losses: error by input, and run time", caption)
    table.add_column("plugin", no_wrap=True)
    table.add_column("form", no_wrap=True)
    for header in (*(given.name for given in INPUTS), "samples", "ms"):
        table.add_column(header, justify="right", no_wrap=True)
    for plugin, form in dict.fromkeys((point.plugin, point.form) for point in points):
        of_form = [point for point in points if (point.plugin, point.form) == (plugin, form)]
        worst = [
            max(p.relative_error for p in of_form if p.input == given.name) for given in INPUTS
        ]
        most = max(point.samples for point in of_form)
        time = _typical([point for point in of_form if point.samples == most])
        table.add_row(plugin, form, *(f"{error:.0e}" for error in worst), str(most), f"{time:.3g}")
    Console().print(table)


def draw(points: Sequence[Point], sizes: Sizes, stem: Path) -> list[Path]:
    """Against the number of samples, a column for each plugin: errors, a row for each input, and run time."""
    plugins = list(dict.fromkeys(point.plugin for point in points))
    # Those with a form to compare with come first: they are what the plot is about.
    plugins.sort(key=lambda name: name not in RIVALS)
    forms = list(
        dict.fromkeys(point.form for name in plugins for point in points if point.plugin == name)
    )
    named = dict(
        zip(
            forms, styles(["the plugin" if form == PLUGIN else form for form in forms]), strict=True
        )
    )
    with panels(len(INPUTS) + 1, len(plugins), max(2.25 * len(plugins), 7.0), 11.0) as (
        figure,
        axes,
    ):
        for column, plugin in enumerate(plugins):
            axes[0][column].set_title(plugin)
            axes[-1][column].set_xlabel("samples per ray")
            for form, style in named.items():
                own = [point for point in points if (point.plugin, point.form) == (plugin, form)]
                for row, given in enumerate(INPUTS):
                    _errors(
                        axes[row][column],
                        [point for point in own if point.input == given.name],
                        style,
                    )
                _times(axes[-1][column], own, style)
        for row, given in enumerate(INPUTS):
            axes[row][0].set_ylabel(f"{given.name}\nrelative error")
        axes[-1][0].set_ylabel("run time (ms)\nforward and backward")
        _frame(axes, points, sizes)
        for plugin, panel in zip(plugins, axes[-1], strict=True):
            _slopes(
                panel, [point.milliseconds for point in points if point.plugin == plugin], plugin
            )
        about = "; ".join(f"{given.name}: {given.about}" for given in INPUTS)
        about += ". Errors beyond $10^{-9}$ and $10^3$ are drawn there."
        title = f"Losses in float32: relative error on {len(INPUTS)} inputs, run time for {sizes.rays} rays on one thread"
        figure.suptitle("\n".join([title, *wrap(about, 110)]), fontsize=11.5)
        legend = _legend(axes[-1])
        figure.legend(
            legend.values(),
            legend.keys(),
            loc="outside lower center",
            ncols=len(legend),
            frameon=False,
        )
        return save(figure, stem)


def _errors(panel: Axes, points: Sequence[Point], style: Style) -> None:
    y = [min(max(point.relative_error, LOWEST), HIGHEST) for point in points]
    _line(panel, [point.samples for point in points], y, style)


def _times(panel: Axes, points: Sequence[Point], style: Style) -> None:
    counts = sorted({point.samples for point in points})
    _line(
        panel,
        counts,
        [_typical([point for point in points if point.samples == n]) for n in counts],
        style,
    )


def _line(panel: Axes, x: Sequence[int], y: Sequence[float], style: Style) -> None:
    if x:
        own = style.label.startswith("the ")
        panel.plot(
            x,
            y,
            color=style.color,
            marker=style.marker,
            label=style.label,
            markeredgewidth=0,
            zorder=3 if own else 2,
        )


def _frame(axes: Sequence[Sequence[Axes]], points: Sequence[Point], sizes: Sizes) -> None:
    """Common limits, tick labels at the outside alone, and lines to compare with."""
    times = [point.milliseconds for point in points]
    for row, panels_of_row in enumerate(axes):
        last = row == len(axes) - 1
        for column, panel in enumerate(panels_of_row):
            panel.set_xscale("log", base=2)
            panel.set_xlim(sizes.samples[0] / 1.4, sizes.samples[-1] * 1.4)
            panel.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            panel.tick_params(labelleft=column == 0, labelbottom=last)
            if last:
                panel.set_ylim(min(times) / 2, max(times) * 3)
            else:
                panel.set_ylim(LOWEST / 3, HIGHEST * 3)
                panel.axhline(ROUNDING, color=GUIDE, linestyle=(0, (4, 3)), linewidth=1.1, zorder=1)
    label = axes[0][0].annotate(
        "float32 rounding", (1, 2 * ROUNDING), xycoords=("axes fraction", "data")
    )
    label.set(color=GUIDE, fontsize=8.5, horizontalalignment="right", verticalalignment="bottom")


def _slopes(panel: Axes, times: Sequence[float], plugin: str) -> None:
    """Where no curve passes: N above short run times and below long ones, N^2 where a form has it."""
    lowest, highest = panel.get_ylim()
    slope(panel, (0.5, highest / 60 if max(times) < highest / 120 else 3 * lowest), 8, 1, "$N$")
    if any(rival.most_samples for rival in RIVALS.get(plugin, ())):
        slope(panel, (0.08, highest / 300), 5, 2, "$N^2$")


def _legend(panels_of_row: Sequence[Axes]) -> dict[str, Artist]:
    """Every label once, with the first line that has it."""
    found: dict[str, Artist] = {}
    for panel in panels_of_row:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return found


def _typical(points: Sequence[Point]) -> float:
    """The median over the inputs, which make no difference to it."""
    return median(point.milliseconds for point in points)
