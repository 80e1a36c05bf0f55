"""What a report knows of a run: what its folder says, read once, with its types."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

METRICS = ("psnr", "ssim", "lpips", "average", "depth_rmse")


@dataclass(frozen=True)
class Evaluation:
    """One line of `metrics.jsonl`, or `results.json`. A metric that could not be had is None.

    train_seconds: of training alone, without compilation and evaluation. views: how many test views were scored.
    whole: whether these were all test views at full size, as at the end of a run.
    """

    step: int
    train_seconds: float
    psnr: float | None
    ssim: float | None
    lpips: float | None
    average: float | None
    depth_rmse: float | None
    views: int
    whole: bool


@dataclass(frozen=True)
class RunRecord:
    """One run folder.

    method: what distinguishes the run from others on its scene: the regularizers or their preset, then every other
        setting that was overridden, without scene and seed.
    scene, views: its name, and the number of training views. held_out: scored on held-out training views.
    evaluations: in the order of time; the last one is `final` if the run is complete.
    final: all test views at full size; None while the run is being written, and for one that failed.
    points_per_second, peak_memory_mb: of the whole run; None while it is being written.
    settings: the configuration, flat (`sampler.coarse` -> 32). command: the overrides that reproduce the run.
    shared: overrides that all runs on the same scene have, and that `method` therefore does not name.
    failure: why it failed; None if it did not. threads: CPU threads that it trained with.
    versions: of the packages that it ran with. finished: when `results.json` was written, seconds since 1970.
    """

    folder: Path
    method: str
    scene: str
    views: int
    seed: int
    held_out: bool
    evaluations: tuple[Evaluation, ...]
    final: Evaluation | None
    points_per_second: float | None
    peak_memory_mb: float | None
    settings: Mapping[str, object]
    command: tuple[str, ...]
    shared: tuple[str, ...] = ()
    failure: str | None = None
    threads: int | None = None
    versions: Mapping[str, str | None] = field(default_factory=dict)
    finished: float | None = None
