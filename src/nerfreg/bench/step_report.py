"""What `nerfreg bench step` shows: the parts of the step, and what it reaches of what the machine can do."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from nerfreg.analysis.tables import new_table
from nerfreg.bench.parts import BACKWARD, REST
from nerfreg.bench.step import Measured


def print_tables(measured: Measured) -> None:
    """The parts, then the figures of the whole step."""
    console = Console()
    console.print(_parts(measured))
    console.print(_figures(measured))


def _parts(measured: Measured) -> Table:
    parts = measured.parts
    total = sum(parts.values())
    table = new_table(
        f"One training step in parts: {measured.scene}, {', '.join(measured.config.reg) or 'vanilla'}",
        f"Of {total:.3g} ms, in steps of their own, at {100 * measured.at:.3g} % of the budget. "
        f"{REST}: zeroing, checks, and gradients added up between the parts.",
    )
    table.add_column("part", no_wrap=True)
    for header in ("forward ms", "backward ms", "share"):
        table.add_column(header, justify="right")
    names = sorted(
        dict.fromkeys(part.removesuffix(BACKWARD) for part in parts), key=lambda name: name == REST
    )
    for name in names:
        forward, backward = parts.get(name, 0.0), parts.get(f"{name}{BACKWARD}")
        share = (forward + (backward or 0.0)) / total
        table.add_row(
            name,
            f"{forward:.2f}",
            "" if backward is None else f"{backward:.2f}",
            f"{100 * share:.1f} %",
        )
    return table


def _figures(measured: Measured) -> Table:
    time, ceilings = measured.milliseconds, measured.ceilings
    sampler, field = measured.config.sampler, measured.config.field
    table = new_table("The whole step", "")
    table.add_column("", no_wrap=True)
    table.add_column("")
    rows = {
        "configuration": f"{measured.config.train.rays} rays x ({sampler.coarse} + {sampler.fine}) samples, "
        f"{field.levels} levels of 2^{field.log2_entries} to {field.finest}, threads: {measured.threads}",
        "time": f"{time.median:.4g} ms (10 to 90 %: {time.p10:.4g} to {time.p90:.4g})",
        "points": f"{measured.points:.0f} and {measured.colors:.0f} colours a step",
        "speed": f"{measured.points_per_second / 1e6:.3g} million points a second",
        "networks": f"{measured.gflops:.3g} GFLOP/s, {100 * measured.gflops / ceilings.network_gflops:.3g} % "
        "of the ceiling of their matrix products",
        "ceilings": f"{ceilings.network_gflops:.3g} GFLOP/s in matrix products of 4096 x 64 x 64, "
        f"{ceilings.square_gflops:.3g} in a large square one; memory {ceilings.bandwidth_gbs:.3g} GB/s",
        "before": f"{measured.compile_seconds:.2f} s to build, compile and take the first step, "
        f"{measured.warmup_seconds:.2f} s more to warm up",
        "peak memory": f"{measured.memory_mb:.0f} MB",
    }
    for name, text in rows.items():
        table.add_row(name, text)
    return table
