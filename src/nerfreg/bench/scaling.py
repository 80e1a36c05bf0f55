"""`nerfreg bench scaling`: the time of a step against its sizes, one at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.table import Table

from nerfreg.analysis.curves import CurvePanel, draw_curves
from nerfreg.analysis.tables import build_table, numbers, select, text
from nerfreg.bench.configured import TINY, StepSizes, make_trainer, set_up, time_steps
from nerfreg.bench.outcome import BenchOutcome, announced, publish_points
from nerfreg.bench.timing import spread
from nerfreg.config.schema import Config
from nerfreg.field.workers import threads
from nerfreg.scenes.scene import Scene

AT = 0.5
"""Share of the budget at which the steps are taken."""
LABELS = {
    "rays": "rays a step",
    "samples": "samples a ray",
    "levels": "levels of the hash grid",
    "entries": "table entries a level",
}


@dataclass(frozen=True, kw_only=True)
class ScalingSizes(StepSizes):
    """values: what each of `LABELS` goes through, while everything else stays as configured."""

    values: Mapping[str, Sequence[int]]


FULL_VALUES = {
    "rays": (256, 512, 1024, 2048, 4096),
    "samples": (16, 32, 64, 128, 256),
    "levels": (2, 4, 8, 16, 32),
    "entries": (2**13, 2**15, 2**17, 2**19, 2**21),
}
QUICK_VALUES = {"rays": (32, 64), "samples": (8, 16), "levels": (2, 4), "entries": (256, 1024)}
FULL = ScalingSizes(values=FULL_VALUES, steps=15, warmup=5)
QUICK = ScalingSizes(values=QUICK_VALUES, steps=2, warmup=1, defaults=TINY)


@dataclass(frozen=True)
class ScalingPoint:
    """One value of one size: milliseconds of a step, and evaluations of the density in it."""

    swept: str
    value: int
    milliseconds: float
    milliseconds_p10: float
    milliseconds_p90: float
    points: float


class ScalingFit(NamedTuple):
    """slope: p in time ~ value^p. fixed, each: of the line time = fixed + each * value, in ms.
    off: the largest relative error of that line. Both are fitted to relative errors."""

    slope: float
    fixed: float
    each: float
    off: float


def run(folder: Path, sizes: ScalingSizes, overrides: tuple[str, ...]) -> BenchOutcome:
    """Measure all values of all sizes around a configuration, and publish the points."""
    config, scene = set_up((*sizes.defaults, *overrides))
    cases = [(swept, value) for swept in LABELS for value in sizes.values[swept]]
    points = [
        measure(config, scene, swept, value, sizes)
        for swept, value in announced(cases, lambda case: f"{case[1]} {LABELS[case[0]]}")
    ]
    table = tabulate(points, config, sizes)
    return publish_points(folder / "scaling", points, table, partial(draw, points))


def measure(
    config: Config, scene: Scene, swept: str, value: int, sizes: ScalingSizes
) -> ScalingPoint:
    """Return the time of a step in which one size has this value."""
    trainer = make_trainer(changed(config, swept, value), scene)
    (timed,) = time_steps([trainer], AT, sizes.warmup, sizes.steps)
    time = spread([1e3 * seconds for seconds in timed.seconds])
    return ScalingPoint(swept, value, time.median, time.p10, time.p90, timed.points)


def changed(config: Config, swept: str, value: int) -> Config:
    """Return the configuration with another value of one size; half of the samples are coarse."""
    field, sampler, train = config.field, config.sampler, config.train
    match swept:
        case "rays":
            return replace(config, train=replace(train, rays=value))
        case "samples":
            halves = replace(sampler, coarse=value // 2, fine=value - value // 2)
            return replace(config, sampler=halves)
        case "levels":
            return replace(config, field=replace(field, levels=value))
    return replace(config, field=replace(field, log2_entries=value.bit_length() - 1))


def fit(points: Sequence[ScalingPoint]) -> ScalingFit:
    """Fit a power and a straight line to the points of one sweep."""
    x = np.array([point.value for point in points], dtype=float)
    y = np.array([point.milliseconds for point in points])
    slope = np.polyfit(np.log(x), np.log(y), 1)[0]
    each, fixed = np.polyfit(x, y, 1, w=1 / y)
    off = np.abs((fixed + each * x) / y - 1).max()
    return ScalingFit(float(slope), float(fixed), float(each), float(off))


def tabulate(points: Sequence[ScalingPoint], config: Config, sizes: ScalingSizes) -> Table:
    """Return each sweep with its ends, its times and its fit."""
    sampler, field, rows = config.sampler, config.field, []
    for swept, label in LABELS.items():
        own = select(points, swept=swept)
        first, last, fitted = own[0], own[-1], fit(own)
        times = f"{first.milliseconds:.3g} to {last.milliseconds:.3g}"
        off = f"{100 * fitted.off:.1f} %"
        rows.append((label, f"{first.value}", f"{last.value}", times, f"{fitted.slope:.2f}", off))
    return build_table(
        f"Time of a step against its sizes: {', '.join(config.reg) or 'vanilla'}",
        f"Around {config.train.rays} rays x ({sampler.coarse} + {sampler.fine}) samples, "
        f"{field.levels} levels of 2^{field.log2_entries} entries; median of {sizes.steps} steps; "
        f"threads: {threads()}. slope: p in time ~ size^p. off: how far the times are from a "
        "straight line, at most.",
        [*text("swept"), *numbers("from", "to", "ms", "slope", "off")],
        rows,
    )


def draw(points: Sequence[ScalingPoint], stem: Path) -> list[Path]:
    """Draw the times of each sweep with their quantiles and their straight line."""
    row = []
    for swept, label in LABELS.items():
        own = select(points, swept=swept)
        x, fitted = [point.value for point in own], fit(own)
        curves = {
            "median": (x, [point.milliseconds for point in own]),
            "10 %": (x, [point.milliseconds_p10 for point in own]),
            "90 %": (x, [point.milliseconds_p90 for point in own]),
            "straight line": (x, [fitted.fixed + fitted.each * value for value in x]),
        }
        row.append(CurvePanel(curves, f"slope {fitted.slope:.2f}", label, "ms" if not row else ""))
    return draw_curves(stem, [row], "Time of a training step against its sizes", (12.5, 3.9), 2)
