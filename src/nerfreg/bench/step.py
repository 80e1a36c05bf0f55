"""`nerfreg bench step`: one training step, whole and in parts, beside the machine's ceilings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any
from unittest.mock import patch

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor, nn

from nerfreg.analysis.statistics import spread
from nerfreg.analysis.tables import build_table, numbers, publish_record, text
from nerfreg.bench import BenchOutcome
from nerfreg.bench.configured import TINY, TrainingSizes, make_trainer, set_up, step_at, time_steps
from nerfreg.bench.parts import BACKWARD, REST, measure_parts
from nerfreg.bench.timing import in_turns
from nerfreg.config.schema import Config
from nerfreg.field.fit import fitted
from nerfreg.field.radiance_field import RadianceField
from nerfreg.field.workers import in_shares, threads
from nerfreg.scenes.scene import Scene
from nerfreg.training.memory import peak_memory_mb

ROWS, WIDTH = 4096, 64
"""The networks' matrix products: chunks of so many points, through layers so wide."""
PASSES = 3
"""Forward, the gradient of the weights and that of the input take one matrix product each."""


@dataclass(frozen=True, kw_only=True)
class StepSizes(TrainingSizes):
    """Share of the budget that schedules see, and the sizes of `measure_ceilings`."""

    at: float = 0.5
    square: int = 2048
    copy_mb: int = 256


FULL = StepSizes(steps=40, warmup=20)
QUICK = StepSizes(steps=3, warmup=1, square=128, copy_mb=1, defaults=TINY)


def run(folder: Path, sizes: StepSizes, overrides: tuple[str, ...]) -> BenchOutcome:
    """Measure a step of the configuration that the overrides choose, and publish the record."""
    config, scene = set_up((*sizes.defaults, *overrides))
    config = replace(config, field=fitted(config.field, scene))
    record = measure(config, scene, sizes)
    Console().print(tabulate(record))
    publish_record(folder / "step.json", "The whole step", record)
    return BenchOutcome([folder / "step.json"], record)


def measure(config: Config, scene: Scene, sizes: StepSizes) -> dict[str, Any]:
    """Build, warm up, time whole steps, then their parts, then the machine.

    Returns:
        The record. Times are in milliseconds unless they are named otherwise; points and colours
        are evaluations; GFLOP/s are those of the networks in the time of the whole step.
    """
    begun = perf_counter()
    trainer = make_trainer(config, scene)
    step_at(trainer, sizes.at)
    built = perf_counter() - begun
    warm = sum(in_turns([lambda: step_at(trainer, sizes.at)], sizes.warmup)[0])
    colors, color = 0, trainer.field.color

    def counted(raw: Tensor, *others: Any) -> Tensor:
        nonlocal colors
        colors += len(raw)
        return color(raw, *others)

    with patch.object(trainer.field, "color", counted):
        (timed,) = time_steps([trainer], sizes.at, 0, sizes.steps)
    parts = measure_parts(trainer, sizes.at, sizes.steps)
    memory, time = peak_memory_mb(), spread([1e3 * seconds for seconds in timed.seconds])
    gflops = step_flop(trainer.field, timed.points, colors / sizes.steps) / time.median / 1e6
    ceilings = measure_ceilings(sizes.square, sizes.copy_mb)
    return {
        "points_per_second": 1e3 * timed.points / time.median,
        "ms": time.median,
        "ms_p10": time.p10,
        "ms_p90": time.p90,
        "parts_ms": parts,
        "points_per_step": timed.points,
        "colors_per_step": colors / sizes.steps,
        "peak_memory_mb": round(memory),
        "compile_seconds": built,
        "warmup_seconds": warm,
        "threads": threads(),
        "gflops": gflops,
        **ceilings,
        "arithmetic_share": gflops / ceilings["ceiling_network_gflops"],
        "at": sizes.at,
        "scene": scene.name,
        "reg": list(config.reg),
        "rays": config.train.rays,
        "samples": config.sampler.coarse + config.sampler.fine,
        "log2_entries": config.field.log2_entries,
        "levels": config.field.levels,
        "finest": config.field.finest,
    }


def tabulate(record: dict[str, Any]) -> Table:
    """Return the parts of the step with their share, the rest last."""
    parts = record["parts_ms"]
    total, rows = sum(parts.values()), []
    names = dict.fromkeys(part.removesuffix(BACKWARD) for part in parts)
    for name in sorted(names, key=lambda name: name == REST):
        forward, backward = parts.get(name, 0.0), parts.get(f"{name}{BACKWARD}")
        share = f"{100 * (forward + (backward or 0.0)) / total:.1f} %"
        rows.append((name, f"{forward:.2f}", "" if backward is None else f"{backward:.2f}", share))
    return build_table(
        f"One training step in parts: {record['scene']}, {', '.join(record['reg']) or 'vanilla'}",
        f"Of {total:.3g} ms, in steps of their own, at {100 * record['at']:.3g} % of the budget. "
        f"{REST}: zeroing, checks, and gradients added up between the parts.",
        [*text("part"), *numbers("forward ms", "backward ms", "share")],
        rows,
    )


def measure_ceilings(square: int, copy_mb: int, repetitions: int = 5) -> dict[str, float]:
    """Return the best rates of the machine with all threads, of some repetitions after a warm-up.

    Args:
        square: Side of one large matrix product.
        copy_mb: Size of a large copy, which is read and written.
        repetitions: Of each measurement.

    Returns:
        GFLOP/s of products of 4096 x 64 x 64, one after the other on every thread, and of the large
        product, and GB/s of the copy.
    """
    count, products = threads(), max(square // WIDTH, 1) * 8
    a, b, product = (torch.rand(square, square) for _ in range(3))
    source, target = (torch.zeros(copy_mb * 2**18) for _ in range(2))

    def on_every_thread() -> None:
        in_shares(count * ROWS, ROWS, lambda start, stop: _multiply(stop - start, products))

    def rate(work: int, call: Callable[[], object]) -> float:
        return work / min(in_turns([call], repetitions + 1)[0][1:]) / 1e9

    network, large = product_flop(ROWS, WIDTH, WIDTH), product_flop(square, square, square)
    of_torch = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        return {
            "ceiling_network_gflops": rate(count * products * network, on_every_thread),
            "ceiling_square_gflops": rate(large, lambda: torch.mm(a, b, out=product)),
            "ceiling_bandwidth_gb_per_second": rate(
                2 * copy_mb * 2**20, lambda: target.copy_(source)
            ),
        }
    finally:
        torch.set_num_threads(of_torch)


def product_flop(rows: int, inner: int, columns: int) -> int:
    """Return the operations of a matrix product: one multiplication and one addition each."""
    return 2 * rows * inner * columns


def step_flop(field: RadianceField, points: float, colors: float) -> float:
    """Return the operations of both networks in a step with so many densities and colours.

    Only matrix products count, and every level of the grid counts as alive.
    """
    density, color = _weights(field.density_network), _weights(field.color_network)
    return 2 * PASSES * (points * density + colors * color)


def _weights(network: nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters() if parameter.dim() == 2)


def _multiply(rows: int, times: int) -> None:
    x, weight, out = torch.rand(rows, WIDTH), torch.rand(WIDTH, WIDTH), torch.empty(rows, WIDTH)
    for _ in range(times):
        torch.mm(x, weight, out=out)
