"""`nerfreg bench render RUN`: how long a run's test views take at full size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from typing import Any

from nerfreg.analysis.statistics import spread
from nerfreg.analysis.tables import publish_record
from nerfreg.bench import BenchOutcome
from nerfreg.bench.timing import seconds_of
from nerfreg.evaluation.trained import TrainedField
from nerfreg.field.workers import threads
from nerfreg.runs.load import load_run
from nerfreg.training.memory import peak_memory_mb


@dataclass(frozen=True)
class RenderSizes:
    """views: how many are timed after the first; they begin anew where there are fewer."""

    views: int


FULL = RenderSizes(views=5)
QUICK = RenderSizes(views=1)


def run(folder: Path, sizes: RenderSizes, words: tuple[str, ...]) -> BenchOutcome:
    """Time test views of the run that the word names, and publish the record."""
    loaded = load_run(Path(words[0]))
    scene = loaded.scene
    record = {
        "run": words[0],
        "scene": scene.name,
        "reg": list(loaded.config.reg),
        **measure(loaded.trained, sizes.views),
        "threads": threads(),
        "peak_memory_mb": round(peak_memory_mb()),
    }
    publish_record(folder / "render.json", f"Test views of {words[0]}", record)
    return BenchOutcome([folder / "render.json"], record)


def measure(trained: TrainedField, views: int) -> dict[str, Any]:
    """Return times and evaluations of test views after the first, which compiles what they run."""
    make, scene = trained.renderer, trained.scene
    cameras = scene.cameras
    first = seconds_of(lambda: make().view(cameras, scene.test[0]))
    occupancy = seconds_of(make)
    renderer, chosen = make(), after_the_first(scene.test, views)
    points, colors = renderer.points, renderer.colors
    time = spread([seconds_of(partial(renderer.view, cameras, view)) for view in chosen])
    rays = cameras.width * cameras.height * len(chosen)
    return {
        "seconds_per_view": time.median,
        "seconds_p10": time.p10,
        "seconds_p90": time.p90,
        "views": len(chosen),
        "width": cameras.width,
        "height": cameras.height,
        "points_per_ray": (renderer.points - points) / rays,
        "colors_per_ray": (renderer.colors - colors) / rays,
        "occupancy_seconds": occupancy,
        "first_view_seconds": first,
    }


def after_the_first(test: Sequence[int], count: int) -> list[int]:
    """Return so many test views from the second on, round and round."""
    return list(islice(cycle(test), 1, 1 + count))
