"""What `nerfreg bench quadrature` shows of its points: a table and a plot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from nerfreg.analysis.figures import Style, panels, save, slope, styles
from nerfreg.analysis.tables import new_table
from nerfreg.bench.media import MEDIA, Medium
from nerfreg.bench.quadrature import QUANTITIES, Point, Sizes, first_below, fitted_order
from nerfreg.bench.samplers import CELLS
from nerfreg.bench.timing import CONDITIONS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LABELS = {
    "uniform": "uniform, midpoints",
    "uniform_jittered": "uniform, jittered (band: 10 to 90 % of rays)",
    "importance": "importance, 1/3 coarse + 2/3 fine",
    "skipping": f"uniform, skipping empty ones of {CELLS} cells",
}
PLOTTED = {
    "exponential": 2,
    "gaussian_bump": 2,
    "shell_1e0": 1,
    "shell_1e6": 1,
    "two_shells": 1,
    "gaussian_shell": 2,
}
"""Media of the plot, and the order of the slope that is drawn beside them."""
GOAL = 0.01
RESOLVED = 1024
"""Samples from which on every ray has one in a shell; orders of stiff media are fitted from here."""
LOWEST = 1e-8


def print_table(points: Sequence[Point], sizes: Sizes) -> None:
    """Orders of convergence in float64, and the work that a colour error of 1 % takes in float32."""
    conditions = CONDITIONS.format(repetitions=sizes.repetitions)
    table = new_table(
        title="Rendering one ray: orders of convergence; samples (µs) for 1 % colour error",
        caption=f"Orders: uniform midpoints in float64, {sizes.samples[-1]} samples down to 64 (stiff: {RESOLVED}). "
        "Samples: per ray in float32, from which on the error stays below. "
        f"Times: {sizes.rays} rays at once; {conditions}.",
    )
    table.add_column("medium", no_wrap=True)
    for header in (*QUANTITIES, *(sampler.replace("_", "\n") for sampler in LABELS)):
        table.add_column(header, justify="right")
    for medium in MEDIA:
        of_medium = [point for point in points if point.medium == medium.name]
        orders = [_order(medium, of_medium, quantity) for quantity in QUANTITIES]
        table.add_row(medium.name, *orders, *(_work(of_medium, sampler) for sampler in LABELS))
    Console().print(table)


def _order(medium: Medium, points: Sequence[Point], quantity: str) -> str:
    fitted = [point for point in points if point.sampler == "uniform" and point.dtype == "float64"]
    order = fitted_order(fitted, quantity, RESOLVED if medium.stiff else 64)
    return "-" if order is None else f"{order:.2f}"


def _work(points: Sequence[Point], sampler: str) -> str:
    point = first_below(
        [p for p in points if p.sampler == sampler and p.dtype == "float32"], "color", GOAL
    )
    if point is None:
        return "never"
    return f"{point.samples} ({point.microseconds:.{0 if point.microseconds >= 10 else 1}f})"


def draw(points: Sequence[Point], sizes: Sizes, stem: Path) -> list[Path]:
    """Errors against run time, a row for each quantity, and against evaluations of the density; PNG and SVG."""
    media = sorted(
        (medium for medium in MEDIA if medium.name in PLOTTED),
        key=lambda m: list(PLOTTED).index(m.name),
    )
    named = dict(zip(LABELS, styles(tuple(LABELS.values())), strict=True))
    shown = [point for point in points if point.dtype == "float32"]
    times = [point.microseconds for point in shown]
    evaluations = [point.evaluations for point in shown if point.evaluations > 0]
    with panels(4, len(media), 13.5, 10.2) as (figure, axes):
        for column, medium in enumerate(media):
            of_medium = [point for point in shown if point.medium == medium.name]
            axes[0][column].set_title(medium.title)
            for row, quantity in enumerate((*QUANTITIES, "color")):
                panel, against = axes[row][column], "microseconds" if row < 3 else "evaluations"
                for sampler, style in named.items():
                    _curve(
                        panel,
                        [p for p in of_medium if p.sampler == sampler],
                        against,
                        quantity,
                        style,
                    )
                panel.set_ylim(LOWEST / 2, 5)
                panel.set_xlim(*_limits(times if row < 3 else evaluations))
                if column:
                    panel.tick_params(labelleft=False)
                if row in (0, 1):
                    panel.tick_params(labelbottom=False)
        for row, label in enumerate(("opacity", "depth", "colour", "colour")):
            axes[row][0].set_ylabel(
                f"{label} error ({'ray lengths' if label == 'depth' else 'relative'})"
            )
            for panel, medium in zip(axes[row], media, strict=True):
                power = PLOTTED[medium.name]
                # Where no curve passes: above those of smooth media, below those of stiff ones.
                place = (0.07, 1e-4 if power == 2 else 1e-5) if medium.stiff else (0.55, 3e-1)
                slope(panel, place, 12, -power, f"$N^{{-{power}}}$")
        for panel in axes[2]:
            panel.set_xlabel("time per ray (µs)")
        for panel in axes[3]:
            panel.set_xlabel("density evaluations per ray")
        figure.suptitle(
            "Rendering one ray in float32: error against run time (upper rows) and against evaluations (lowest row)\n"
            f"{sizes.samples[0]} to {sizes.samples[-1]} samples per ray, doubling from point to point; "
            "two smooth densities, four with shells of 1/768 of the ray; errors below $10^{-8}$ are drawn there",
            fontsize=11.5,
        )
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
        return save(figure, stem)


def _curve(panel: Axes, points: Sequence[Point], against: str, quantity: str, style: Style) -> None:
    points = [point for point in points if getattr(point, against) > 0]
    x = [getattr(point, against) for point in points]
    y = [max(point.error(quantity), LOWEST) for point in points]
    panel.plot(x, y, color=style.color, marker=style.marker, label=style.label, markeredgewidth=0)
    if points and points[0].sampler == "uniform_jittered":
        low, high = (
            [max(getattr(p, f"{quantity}_error_{q}"), LOWEST) for p in points]
            for q in ("p10", "p90")
        )
        panel.fill_between(x, low, high, color=style.color, alpha=0.15, linewidth=0)


def _limits(values: Sequence[float]) -> tuple[float, float]:
    return min(values) / 1.5, max(values) * 1.5
