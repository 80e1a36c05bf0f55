"""`nerfreg bench scaling`: the time of a step against its sizes, one at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.table import Table

from nerfreg.analysis.curves import Dot, draw_curves
from nerfreg.analysis.statistics import spread
from nerfreg.analysis.tables import build_table, numbers, publish_points, select, text
from nerfreg.bench import BenchOutcome, configured
from nerfreg.bench.configured import TINY, TrainingSizes
from nerfreg.config.schema import Config
from nerfreg.field.workers import threads

AT = 0.5
"""Share of the budget at which the steps are taken."""
LABELS = {
    "rays": "rays a step",
    "samples": "samples a ray",
    "levels": "levels of the hash grid",
    "entries": "table entries a level",
}


@dataclass(frozen=True, kw_only=True)
class ScalingSizes(TrainingSizes):
    """What each of `LABELS` goes through, while everything else stays as configured."""

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


def run(folder: Path, sizes: ScalingSizes, overrides: tuple[str, ...]) -> BenchOutcome:
    """Measure all values of all sizes around a configuration, and publish the points."""
    config, scene = configured.set_up((*sizes.defaults, *overrides))
    points = []
    cases = [(swept, value) for swept in LABELS for value in sizes.values[swept]]
    for swept, value in configured.announced(cases, lambda case: f"{case[1]} {LABELS[case[0]]}"):
        trainer = configured.make_trainer(changed(config, swept, value), scene)
        (timed,) = configured.time_steps([trainer], AT, sizes.warmup, sizes.steps)
        time = spread([1e3 * seconds for seconds in timed.seconds])
        points.append(ScalingPoint(swept, value, time.median, time.p10, time.p90, timed.points))
        del trainer
    table = tabulate(points, config, sizes)
    return BenchOutcome(publish_points(folder / "scaling", points, table, draw))


def changed(config: Config, swept: str, value: int) -> Config:
    """Return the configuration with another value of one size; half of the samples are coarse."""
    match swept:
        case "rays":
            return replace(config, train=replace(config.train, rays=value))
        case "samples":
            halves = replace(config.sampler, coarse=value // 2, fine=value - value // 2)
            return replace(config, sampler=halves)
        case "levels":
            return replace(config, field=replace(config.field, levels=value))
    return replace(config, field=replace(config.field, log2_entries=value.bit_length() - 1))


def fit(points: Sequence[ScalingPoint]) -> tuple[float, list[float]]:
    """Return p of time ~ value^p for one sweep, and the straight line's time at each value.

    Both are least squares of relative errors.
    """
    x = np.array([point.value for point in points], dtype=float)
    y = np.array([point.milliseconds for point in points])
    each, fixed = np.polyfit(x, y, 1, w=1 / y)
    return float(np.polyfit(np.log(x), np.log(y), 1)[0]), (fixed + each * x).tolist()


def tabulate(points: Sequence[ScalingPoint], config: Config, sizes: ScalingSizes) -> Table:
    """Return each sweep with its ends, its times and its fit."""
    sampler, field, rows = config.sampler, config.field, []
    for swept, label in LABELS.items():
        own = select(points, swept=swept)
        slope, line = fit(own)
        off = max(abs(time / p.milliseconds - 1) for time, p in zip(line, own, strict=True))
        times = f"{own[0].milliseconds:.3g} to {own[-1].milliseconds:.3g}"
        ends = (f"{own[0].value}", f"{own[-1].value}")
        rows.append((label, *ends, times, f"{slope:.2f}", f"{100 * off:.1f} %"))
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
    dots = []
    for swept, label in LABELS.items():
        own = select(points, swept=swept)
        for p, line in zip(own, fit(own)[1], strict=True):
            times = (p.milliseconds, p.milliseconds_p10, p.milliseconds_p90, line)
            for curve, time in zip(("median", "10 %", "90 %", "straight line"), times, strict=True):
                dots.append(Dot("time of a step (ms)", label, curve, p.value, time))
    return draw_curves(stem, dots, "Time of a training step against its sizes", (12.5, 3.9))
