"""The columns of a comparison: what they show of a run, and how."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from nerfreg.reports.records import RunRecord
from nerfreg.reports.statistics import Statistic, summarize
from nerfreg.reports.tables import Cell, Column

PSNR = Column("PSNR", "dB", ".2f", "up", "psnr")
SSIM = Column("SSIM", "", ".3f", "up", "ssim")
LPIPS = Column("LPIPS", "", ".3f", "down", "lpips")
AVERAGE = Column("average", "", ".3f", "down", "average")
DEPTH = Column("depth RMSE", "", ".3f", "down", "depth_rmse")
TRAIN = Column("train", "s", ".0f", "down", "train_seconds")
SPEED = Column("points", "M/s", ".2f", "up", "million_points_per_second")
REACHED = Column("to a PSNR", "s", ".0f", "down", "seconds_to_psnr")
STEP = Column("step", "ms", ".1f", "down", "milliseconds_per_step")
RELATIVE = Column("relative to vanilla", "", ".2f", "down", "relative_to_vanilla")


def columns_of(scenes: Sequence[Sequence[RunRecord]], timed: str | None) -> tuple[Column, ...]:
    """Depth errors only where the depth of every scene is known. timed: the heading of seconds to a PSNR."""
    finals = [[run.final for run in runs if run.final] for runs in scenes]
    longest = max((final.train_seconds for of_scene in finals for final in of_scene), default=0.0)
    digits = ".0f" if longest >= 100 else ".1f" if longest >= 10 else ".3f"
    has_depth = all(any(final.depth_rmse is not None for final in of_scene) for of_scene in finals)
    depth = (DEPTH,) if has_depth else ()
    reached = (replace(REACHED, name=timed, format=digits),) if timed else ()
    return (PSNR, SSIM, LPIPS, AVERAGE, *depth, replace(TRAIN, format=digits), SPEED, *reached)


VALUES: dict[str, Callable[[RunRecord], float | None]] = {
    PSNR.key: lambda run: run.final.psnr if run.final else None,
    SSIM.key: lambda run: run.final.ssim if run.final else None,
    LPIPS.key: lambda run: run.final.lpips if run.final else None,
    AVERAGE.key: lambda run: run.final.average if run.final else None,
    DEPTH.key: lambda run: run.final.depth_rmse if run.final else None,
    TRAIN.key: lambda run: run.final.train_seconds if run.final else None,
    SPEED.key: lambda run: None if run.points_per_second is None else run.points_per_second / 1e6,
}


def statistic_of(column: Column, runs: Sequence[RunRecord]) -> Statistic | None:
    return summarize(VALUES[column.key](run) for run in runs)


def cell_of(statistic: Statistic | None) -> Cell:
    return Cell(None) if statistic is None else Cell(statistic.mean, statistic.std, statistic.count)
