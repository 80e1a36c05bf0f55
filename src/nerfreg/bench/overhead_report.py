"""What `nerfreg bench overhead` shows: each variant's ratio to vanilla, beside its limit, as a table and as bars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import TYPE_CHECKING

from rich.console import Console

from nerfreg.analysis.figures import GUIDE, PALETTE, panels, save
from nerfreg.analysis.tables import new_table
from nerfreg.bench.overhead import CORE, NO_MANAGER, PLUGIN, PRESET, Point, Sizes
from nerfreg.config.schema import Config
from nerfreg.field.workers import threads

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Limit:
    """What a ratio may be: at most `most`, and at least `least`."""

    most: float
    least: float = 0.0

    def __str__(self) -> str:
        return f"{self.least:.2f}-{self.most:.2f}" if self.least else f"{self.most:.2f}"

    def holds(self, ratio: float) -> bool:
        """To two digits, which is all that a limit has."""
        return self.least <= round(ratio, 2) <= self.most


LIMITS = {
    NO_MANAGER: Limit(1.02, 0.98),
    "combinerf": Limit(1.15),
    "distortion": Limit(1.03),
    "full_geometry": Limit(1.03),
    "depth_smoothness": Limit(1.03),
    "entropy": Limit(1.03),
    "lipschitz": Limit(1.05),
    "encoding_mask": Limit(0.85),
    "annealing": Limit(1.0),
    "adversarial": Limit(2.3),
}
"""What a regularizer's idea may cost; the others have none."""


@dataclass(frozen=True)
class Overhead:
    """Means over all shares. ratio, p10, p90: of time to vanilla's. points: ratio of density evaluations."""

    variant: str
    kind: str
    ratio: float
    p10: float
    p90: float
    points: float


def summarize(points: Sequence[Point]) -> list[Overhead]:
    """One line for each variant, in the order in which they were measured."""
    summary = []
    for name in dict.fromkeys(point.variant for point in points):
        own = [point for point in points if point.variant == name]
        summary.append(
            Overhead(
                variant=name,
                kind=own[0].kind,
                ratio=mean(point.ratio for point in own),
                p10=mean(point.ratio_p10 for point in own),
                p90=mean(point.ratio_p90 for point in own),
                points=mean(point.points / point.vanilla_points for point in own),
            )
        )
    return summary


def print_table(summary: Sequence[Overhead], config: Config, scene: str, sizes: Sizes) -> None:
    """Ratio, spread, points and limit of every variant."""
    shares = ", ".join(f"{100 * share:g}" for share in sizes.shares)
    table = new_table(
        f"Time of a training step against vanilla: {scene}, {config.train.rays} rays x "
        f"({config.sampler.coarse} + {config.sampler.fine}) samples",
        f"Median over {sizes.steps} alternating steps of the ratio to vanilla's step in the same round, and its 10 and "
        f"90 % quantiles, averaged over {shares} % of the budget. points: density evaluations, against vanilla's. "
        f"Threads: {threads()}.",
    )
    table.add_column("variant", no_wrap=True)
    for header in ("ratio", "10-90 %", "points", "limit", ""):
        table.add_column(header, justify="right", no_wrap=True)
    for line in summary:
        limit = LIMITS.get(line.variant)
        verdict = "" if limit is None or limit.holds(line.ratio) else "missed"
        table.add_row(
            line.variant,
            f"{line.ratio:.3f}",
            f"{line.p10:.2f}-{line.p90:.2f}",
            f"{line.points:.2f}",
            "" if limit is None else str(limit),
            verdict,
        )
    Console().print(table)


def draw(summary: Sequence[Overhead], stem: Path) -> list[Path]:
    """A bar for each variant, its spread as a line, its limits as marks; PNG and SVG."""
    colors = dict(zip((CORE, PLUGIN, PRESET), (PALETTE[2], PALETTE[0], PALETTE[4]), strict=True))
    with panels(1, 1, 8.0, 1.6 + 0.3 * len(summary)) as (figure, axes):
        panel = axes[0][0]
        panel.set_xscale("linear")
        panel.set_yscale("linear")
        for row, line in enumerate(summary):
            panel.barh(row, line.ratio, height=0.62, color=colors[line.kind], alpha=0.85)
            panel.plot(
                (line.p10, line.p90),
                (row, row),
                color="black",
                linewidth=1.2,
                solid_capstyle="butt",
            )
            _mark(panel, row, LIMITS.get(line.variant))
        panel.axvline(1, color=GUIDE, linestyle=(0, (4, 3)), linewidth=1.1)
        panel.set_yticks(range(len(summary)), [line.variant for line in summary])
        panel.set_ylim(len(summary) - 0.4, -0.6)
        panel.set_xlim(0, 1.05 * max(1.1, *(max(line.p90, line.ratio) for line in summary)))
        panel.set_xlabel("time of a step, vanilla = 1 (line: 10 to 90 %; red: limit)")
        figure.suptitle(
            "What each regularizer and each preset makes of a training step", fontsize=11.5
        )
        return save(figure, stem)


def _mark(panel: Axes, row: int, limit: Limit | None) -> None:
    if limit is not None:
        ends = [limit.least, limit.most] if limit.least else [limit.most]
        panel.vlines(ends, row - 0.42, row + 0.42, color=PALETTE[1], linewidth=2.2, zorder=3)
