"""`nerfreg bench render RUN`: how long a run's test views take at full size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from pathlib import Path
from time import perf_counter
from typing import Any

from rich.console import Console

from nerfreg.analysis.tables import Outcome, new_table, write_record
from nerfreg.bench.timing import spread
from nerfreg.field import RadianceField
from nerfreg.field.workers import threads
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.views import ViewRenderer
from nerfreg.runs.load import load_run
from nerfreg.scenes import Scene
from nerfreg.training.memory import peak_memory_mb


@dataclass(frozen=True)
class Sizes:
    """views: timed after the first; they begin anew where there are fewer."""

    views: int


FULL = Sizes(views=5)
QUICK = Sizes(views=1)


def run(folder: Path, sizes: Sizes, words: tuple[str, ...]) -> Outcome:
    """Time test views of a run; print a table; write a JSON file."""
    name = words[0]
    config, scene, field, _ = load_run(Path(name))
    record = {
        "run": name,
        "scene": scene.name,
        "reg": list(config.reg),
        **measure(field, config.sampler, scene, sizes.views),
        "threads": threads(),
        "peak_memory_mb": round(peak_memory_mb()),
    }
    print_table(record)
    return write_record(folder / "render.json", record)


def measure(
    field: RadianceField, sampler: SamplerConfig, scene: Scene, views: int
) -> dict[str, Any]:
    """Times and evaluations of some test views after the first, which compiles what the others run."""
    begun = perf_counter()
    ViewRenderer(field, sampler, scene).view(scene.cameras, scene.test[0])
    first = perf_counter() - begun
    begun = perf_counter()
    renderer = ViewRenderer(field, sampler, scene)
    occupancy = perf_counter() - begun
    points, colors = renderer.points, renderer.colors
    chosen = after_the_first(scene.test, views)
    seconds = []
    for view in chosen:
        begun = perf_counter()
        renderer.view(scene.cameras, view)
        seconds.append(perf_counter() - begun)
    time = spread(seconds)
    rays = scene.cameras.width * scene.cameras.height * len(chosen)
    return {
        "seconds_per_view": time.median,
        "seconds_p10": time.p10,
        "seconds_p90": time.p90,
        "views": len(chosen),
        "width": scene.cameras.width,
        "height": scene.cameras.height,
        "points_per_ray": (renderer.points - points) / rays,
        "colors_per_ray": (renderer.colors - colors) / rays,
        "occupancy_seconds": occupancy,
        "first_view_seconds": first,
    }


def after_the_first(test: Sequence[int], count: int) -> list[int]:
    """So many test views from the second on, round and round."""
    return list(islice(cycle(test), 1, 1 + count))


def print_table(record: dict[str, Any]) -> None:
    table = new_table(f"Test views of {record['run']}", f"Threads: {record['threads']}.")
    table.add_column("", no_wrap=True)
    table.add_column("")
    for name, text in (
        ("scene", f"{record['scene']}, {', '.join(record['reg']) or 'vanilla'}"),
        ("size", f"{record['width']} x {record['height']}"),
        (
            "time",
            f"{record['seconds_per_view']:.3g} s a view, median of {record['views']} "
            f"(10 to 90 %: {record['seconds_p10']:.3g} to {record['seconds_p90']:.3g})",
        ),
        (
            "each ray",
            f"{record['points_per_ray']:.3g} densities, {record['colors_per_ray']:.3g} colours",
        ),
        ("occupancy grid", f"{record['occupancy_seconds']:.3g} s, once"),
        (
            "first view",
            f"{record['first_view_seconds']:.3g} s, with the grid and whatever had to be compiled",
        ),
        ("peak memory", f"{record['peak_memory_mb']} MB"),
    ):
        table.add_row(name, text)
    Console().print(table)
