"""What regularizers make of the time of a training step, as bars."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nerfreg.reports.axes import shortened
from nerfreg.reports.methods import VANILLA
from nerfreg.reports.style import FAINT, GUIDE, INK, PALETTE, PANEL, panels, save
from nerfreg.reports.timing import Cost

LINE = 34
"""Characters of a name on one line."""


def draw_costs(costs: Sequence[Cost], title: str, stem: Path) -> list[Path]:
    """A bar for each method, its ratio to vanilla beside it, cheapest first; PNG and SVG.

    Methods with nothing to be compared with have no bar; vanilla is grey.
    """
    bars = sorted(
        ((cost.relative, cost) for cost in costs if cost.relative is not None),
        key=lambda bar: bar[0],
    )
    threads = {cost.threads for cost in costs}
    with panels(1, 1.45 * PANEL[0], 0.75 + 0.27 * len(bars)) as (figure, (panel,)):
        for row, (ratio, cost) in enumerate(bars):
            panel.barh(
                row,
                ratio,
                height=0.64,
                color=FAINT if cost.method.startswith(VANILLA) else PALETTE[0],
            )
            panel.text(
                1.02, row, f"{ratio:.2f}  ({1000 * cost.seconds_per_step:.3g} ms)", va="center", fontsize=7.5,
                transform=panel.get_yaxis_transform(),
            )  # fmt: skip
        panel.axvline(1, color=GUIDE, linewidth=1, linestyle=(0, (4, 3)))
        names = [
            cost.method if len(threads) == 1 else f"{cost.method}, {cost.threads} threads"
            for _, cost in bars
        ]
        panel.set_yticks(range(len(bars)), list(map(_two_lines, names)), linespacing=0.95)
        panel.set_ylim(len(bars) - 0.45, -0.55)
        panel.set_xlim(0, 1.04 * max(1.0, *(ratio for ratio, _ in bars)))
        panel.grid(axis="y", visible=False)
        panel.tick_params(axis="y", length=0)
        panel.set_xlabel("time of a training step, vanilla = 1")
        figure.suptitle(title, fontsize=9.5, color=INK)
        return save(figure, stem)


def _two_lines(name: str) -> str:
    """A long name cut after a comma, a plus or a space, and shortened if two lines do not hold it."""
    if len(name) <= LINE:
        return name
    end = max(name.rfind(mark, 0, LINE) for mark in (", ", "+", " ")) + 1 or LINE
    return f"{name[:end].strip()}\n{shortened(name[end:].strip(), LINE)}"
