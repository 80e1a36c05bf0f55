"""`nerfreg bench step`: one training step of any configuration, whole and in parts, beside the machine's ceilings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from torch import Tensor

from nerfreg.analysis.tables import Outcome, write_record
from nerfreg.bench.ceilings import Ceilings, measure_ceilings, step_flop
from nerfreg.bench.configured import TINY, compose, make_trainer, prepare_cpu, step_at
from nerfreg.bench.parts import measure_parts, replaced
from nerfreg.bench.timing import Spread, in_turns, spread
from nerfreg.config.schema import Config
from nerfreg.field.fit import fitted
from nerfreg.field.workers import threads
from nerfreg.scenes import load_scene
from nerfreg.scenes.scene import Scene
from nerfreg.training.memory import keep_large_blocks, peak_memory_mb
from nerfreg.training.trainer import Trainer


@dataclass(frozen=True)
class Sizes:
    """steps: timed whole, and as many again in parts. warmup: steps before them. at: share of the budget that schedules
    see. square, copy_mb: of the machine's ceilings. defaults: overrides that the command line may override."""

    steps: int
    warmup: int
    at: float
    square: int
    copy_mb: int
    defaults: tuple[str, ...] = ()


FULL = Sizes(steps=40, warmup=20, at=0.5, square=2048, copy_mb=256)
QUICK = Sizes(steps=3, warmup=1, at=0.5, square=128, copy_mb=1, defaults=TINY)


@dataclass(frozen=True)
class Measured:
    """A step of a configuration at share `at` of its budget.

    milliseconds: of whole steps. parts: milliseconds of each part, in steps of their own. points, colors: evaluations
    of density and colour in a step. flop: floating point operations of the networks in a step. memory_mb: the peak of
    the process. compile_seconds: to build the trainer and take the first step. warmup_seconds: the steps after that
    one that were not timed.
    """

    scene: str
    config: Config
    at: float
    milliseconds: Spread
    parts: dict[str, float]
    points: float
    colors: float
    flop: float
    memory_mb: float
    compile_seconds: float
    warmup_seconds: float
    threads: int
    ceilings: Ceilings

    @property
    def points_per_second(self) -> float:
        return self.points / self.milliseconds.median * 1e3

    @property
    def gflops(self) -> float:
        """Arithmetic of the networks, in the time of the whole step."""
        return self.flop / self.milliseconds.median / 1e6

    def record(self) -> dict[str, Any]:
        """What `nerfreg bench step` prints as JSON."""
        sampler, field = self.config.sampler, self.config.field
        return {
            "points_per_second": self.points_per_second,
            "ms": self.milliseconds.median,
            "ms_p10": self.milliseconds.p10,
            "ms_p90": self.milliseconds.p90,
            "parts_ms": self.parts,
            "points_per_step": self.points,
            "colors_per_step": self.colors,
            "peak_memory_mb": round(self.memory_mb),
            "compile_seconds": self.compile_seconds,
            "warmup_seconds": self.warmup_seconds,
            "threads": self.threads,
            "gflops": self.gflops,
            "ceiling_network_gflops": self.ceilings.network_gflops,
            "ceiling_square_gflops": self.ceilings.square_gflops,
            "ceiling_bandwidth_gb_per_second": self.ceilings.bandwidth_gbs,
            "arithmetic_share": self.gflops / self.ceilings.network_gflops,
            "at": self.at,
            "scene": self.scene,
            "reg": list(self.config.reg),
            "rays": self.config.train.rays,
            "samples": sampler.coarse + sampler.fine,
            "log2_entries": field.log2_entries,
            "levels": field.levels,
            "finest": field.finest,
        }


def run(folder: Path, sizes: Sizes, overrides: tuple[str, ...]) -> Outcome:
    """Measure a step of the configuration that the overrides choose; print tables; write a JSON file."""
    from nerfreg.bench.step_report import print_tables

    keep_large_blocks()
    config = compose((*sizes.defaults, *overrides))
    prepare_cpu(config)
    scene = load_scene(config.scene)
    measured = measure(replace(config, field=fitted(config.field, scene)), scene, sizes)
    print_tables(measured)
    return write_record(folder / "step.json", measured.record())


def measure(config: Config, scene: Scene, sizes: Sizes) -> Measured:
    """Build, warm up, time whole steps, then their parts, then the machine."""
    begun = perf_counter()
    trainer = make_trainer(config, scene)
    step_at(trainer, sizes.at)
    built = perf_counter()
    for _ in range(sizes.warmup):
        step_at(trainer, sizes.at)
    warm = perf_counter()
    points_before, counted = trainer.renderer.points, _CountedColors(trainer.field.color)
    with replaced(trainer.field, "color", counted):
        seconds = time_steps(trainer, sizes.at, sizes.steps)
    points, colors = (
        (trainer.renderer.points - points_before) / sizes.steps,
        counted.colors / sizes.steps,
    )
    parts = measure_parts(trainer, sizes.at, sizes.steps)
    return Measured(
        scene=scene.name,
        config=config,
        at=sizes.at,
        milliseconds=spread([1e3 * time for time in seconds]),
        parts=parts,
        points=points,
        colors=colors,
        flop=step_flop(trainer.field, points, colors),
        memory_mb=peak_memory_mb(),
        compile_seconds=built - begun,
        warmup_seconds=warm - built,
        threads=threads(),
        ceilings=measure_ceilings(sizes.square, sizes.copy_mb),
    )


def time_steps(trainer: Trainer, at: float, steps: int) -> list[float]:
    """Seconds that each of some steps takes."""
    return in_turns([lambda: step_at(trainer, at)], steps)[0]


class _CountedColors:
    """`RadianceField.color`, and how many colours it was asked for."""

    def __init__(self, color: Callable[..., Tensor]) -> None:
        self._color = color
        self.colors = 0

    def __call__(self, raw: Tensor, harmonics: Tensor, active: float | None = None) -> Tensor:
        self.colors += len(raw)
        return self._color(raw, harmonics, active)
