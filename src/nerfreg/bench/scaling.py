"""`nerfreg bench scaling`: the time of a step against rays, samples, levels and table size, one at a time."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from nerfreg.analysis.figures import PALETTE, panels, save
from nerfreg.analysis.tables import Outcome, new_table, write_points
from nerfreg.bench.configured import TINY, compose, make_trainer, prepare_cpu, step_at
from nerfreg.bench.timing import in_turns, spread
from nerfreg.config.schema import Config
from nerfreg.field.workers import threads
from nerfreg.scenes import load_scene
from nerfreg.training.memory import keep_large_blocks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AT = 0.5
"""Share of the budget at which the steps are taken."""
LABELS = {
    "rays": "rays a step",
    "samples": "samples a ray",
    "levels": "levels of the hash grid",
    "entries": "table entries a level",
}


@dataclass(frozen=True)
class Sizes:
    """What each sweep goes through; everything else stays as it is configured. log2_entries: of the table.
    steps: timed for each point. warmup: steps before them. defaults: overrides that the command line may override."""

    rays: tuple[int, ...]
    samples: tuple[int, ...]
    levels: tuple[int, ...]
    log2_entries: tuple[int, ...]
    steps: int
    warmup: int
    defaults: tuple[str, ...] = ()


FULL = Sizes(
    (256, 512, 1024, 2048, 4096),
    (16, 32, 64, 128, 256),
    (2, 4, 8, 16, 32),
    (13, 15, 17, 19, 21),
    15,
    5,
)
QUICK = Sizes((32, 64), (8, 16), (2, 4), (8, 10), steps=2, warmup=1, defaults=TINY)


@dataclass(frozen=True)
class Point:
    """swept: "rays", "samples", "levels" or "entries"; value: how many. Milliseconds of a step: median, quantiles."""

    swept: str
    value: int
    milliseconds: float
    milliseconds_p10: float
    milliseconds_p90: float
    points: float


@dataclass(frozen=True)
class Fit:
    """slope: p in time ~ value^p. fixed, each: of the straight line time = fixed + each * value, in milliseconds.
    off: the largest relative error of that line. Both by least squares of relative errors."""

    slope: float
    fixed: float
    each: float
    off: float


def run(folder: Path, sizes: Sizes, overrides: tuple[str, ...]) -> Outcome:
    """Measure all sweeps; print a table; write a CSV file and a plot."""
    keep_large_blocks()
    config = compose((*sizes.defaults, *overrides))
    prepare_cpu(config)
    points = measure(config, sizes)
    print_table(points, config, sizes)
    return Outcome(
        [write_points(folder / "scaling.csv", points), *draw(points, folder / "scaling")]
    )


def measure(config: Config, sizes: Sizes) -> list[Point]:
    """One point for each value of each sweep."""
    scene = load_scene(config.scene)
    points = []
    with Console(stderr=True).status("") as status:
        for swept, value, changed in sweeps(config, sizes):
            status.update(f"{value} {LABELS[swept]}")
            trainer = make_trainer(changed, scene)
            for _ in range(sizes.warmup):
                step_at(trainer, AT)
            before = trainer.renderer.points
            seconds = in_turns([lambda trainer=trainer: step_at(trainer, AT)], sizes.steps)[0]  # type: ignore[misc]
            time = spread([1e3 * second for second in seconds])
            evaluated = (trainer.renderer.points - before) / sizes.steps
            points.append(Point(swept, value, time.median, time.p10, time.p90, evaluated))
            del trainer
            gc.collect()
    return points


def sweeps(config: Config, sizes: Sizes) -> list[tuple[str, int, Config]]:
    """What is swept, its value, and the configuration that has it. Half the samples are coarse."""
    field, sampler, train = config.field, config.sampler, config.train
    changed = [("rays", n, replace(config, train=replace(train, rays=n))) for n in sizes.rays]
    for n in sizes.samples:
        changed.append(
            (
                "samples",
                n,
                replace(config, sampler=replace(sampler, coarse=n // 2, fine=n - n // 2)),
            )
        )
    changed += [
        ("levels", n, replace(config, field=replace(field, levels=n))) for n in sizes.levels
    ]
    for log2 in sizes.log2_entries:
        changed.append(
            ("entries", 2**log2, replace(config, field=replace(field, log2_entries=log2)))
        )
    return changed


def fit(points: Sequence[Point]) -> Fit:
    """A power and a straight line through the points of one sweep."""
    x = np.array([point.value for point in points], dtype=float)
    y = np.array([point.milliseconds for point in points])
    slope = np.polyfit(np.log(x), np.log(y), 1)[0]
    each, fixed = np.polyfit(x, y, 1, w=1 / y)
    off = np.abs((fixed + each * x) / y - 1).max()
    return Fit(float(slope), float(fixed), float(each), float(off))


def print_table(points: Sequence[Point], config: Config, sizes: Sizes) -> None:
    """Every sweep with its times and its fit."""
    sampler, field = config.sampler, config.field
    table = new_table(
        f"Time of a step against its sizes: {', '.join(config.reg) or 'vanilla'}",
        f"Around {config.train.rays} rays x ({sampler.coarse} + {sampler.fine}) samples, {field.levels} levels of "
        f"2^{field.log2_entries} entries; median of {sizes.steps} steps; threads: {threads()}. "
        "slope: p in time ~ size^p. off: how far the times are from a straight line, at most.",
    )
    table.add_column("swept", no_wrap=True)
    for header in ("from", "to", "ms", "slope", "off"):
        table.add_column(header, justify="right", no_wrap=True)
    for swept in LABELS:
        own = [point for point in points if point.swept == swept]
        first, last, fitted = own[0], own[-1], fit(own)
        times = f"{first.milliseconds:.3g} to {last.milliseconds:.3g}"
        off = f"{100 * fitted.off:.1f} %"
        table.add_row(
            LABELS[swept], str(first.value), str(last.value), times, f"{fitted.slope:.2f}", off
        )
    Console().print(table)


def draw(points: Sequence[Point], stem: Path) -> list[Path]:
    """A log-log panel for each sweep, with its straight line; PNG and SVG."""
    with panels(1, len(LABELS), 12.5, 3.9) as (figure, axes):
        for panel, (swept, label) in zip(axes[0], LABELS.items(), strict=True):
            _sweep(panel, [point for point in points if point.swept == swept])
            panel.set_xlabel(label)
        axes[0][0].set_ylabel("time of a step (ms)")
        low, high = min(p.milliseconds_p10 for p in points), max(p.milliseconds_p90 for p in points)
        for panel in axes[0]:
            panel.set_ylim(low / 1.4, high * 1.4)
        figure.suptitle(
            "Time of a training step against its sizes (bars: 10 to 90 %; line: straight)",
            fontsize=11.5,
        )
        return save(figure, stem)


def _sweep(panel: Axes, points: Sequence[Point]) -> None:
    x = np.array([point.value for point in points], dtype=float)
    y = [point.milliseconds for point in points]
    spans = [
        [p.milliseconds - p.milliseconds_p10 for p in points],
        [p.milliseconds_p90 - p.milliseconds for p in points],
    ]
    panel.errorbar(x, y, spans, color=PALETTE[0], marker="o", linestyle="none", capsize=2)
    fitted = fit(points)
    line = np.geomspace(x[0], x[-1], 50)
    panel.plot(line, fitted.fixed + fitted.each * line, color=PALETTE[1])
    panel.set_title(f"slope {fitted.slope:.2f}")
    panel.set_xscale("log", base=2)
