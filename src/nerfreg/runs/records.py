"""What a run left in its folder, with types."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

METRICS = ("psnr", "ssim", "lpips", "average", "depth_rmse")
"""Scores that an evaluation may have."""


@dataclass(frozen=True)
class EvaluationRecord:
    """One line of `metrics.jsonl`, or `results.json`. A metric that could not be had is None.

    Attributes:
        step: Number of steps so far.
        train_seconds: Of training alone, without compilation and evaluation.
        psnr: In dB.
        ssim: Of the same views.
        lpips: Of the same views.
        average: Geometric mean of the three as errors.
        depth_rmse: In world units.
        views: How many test views were scored.
        whole: Whether these were all test views at full size, as at the end of a run.
        metrics: What plugins measured, by "plugin.metric".
    """

    step: int
    train_seconds: float
    psnr: float | None = None
    ssim: float | None = None
    lpips: float | None = None
    average: float | None = None
    depth_rmse: float | None = None
    views: int = 0
    whole: bool = False
    metrics: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class RunRecord:
    """One run folder.

    Attributes:
        folder: Where it lies.
        scene: Its name.
        views: Number of training views; 0 where nobody has counted them yet.
        held_out: Whether it is scored on held-out training views.
        seed: Of its random numbers.
        evaluations: In the order of time; the last one is `final` if the run is complete.
        final: All test views at full size. None while the run is being written, and for one that
            failed.
        settings: The configuration, flat: `sampler.coarse` -> 32.
        command: The overrides that reproduce the run.
        points_per_second: Of the whole run; None while it is being written.
        peak_memory_mb: Of the whole run; None while it is being written.
        failure: Why it failed; None if it did not.
        threads: CPU threads that it trained with.
        versions: Of the packages that it ran with.
        finished: When `results.json` was written, in seconds since 1970.
    """

    folder: Path
    scene: str
    views: int
    held_out: bool = False
    seed: int = 0
    evaluations: tuple[EvaluationRecord, ...] = ()
    final: EvaluationRecord | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    command: tuple[str, ...] = ()
    points_per_second: float | None = None
    peak_memory_mb: float | None = None
    failure: str | None = None
    threads: int | None = None
    versions: Mapping[str, str | None] = field(default_factory=dict)
    finished: float | None = None

    @property
    def last(self) -> EvaluationRecord | None:
        """The latest evaluation, if there is any."""
        return self.evaluations[-1] if self.evaluations else None

    @property
    def state(self) -> str:
        """One of "failed", "complete" and "incomplete"."""
        if self.failure is not None:
            return "failed"
        return "incomplete" if self.final is None else "complete"

    @property
    def progress(self) -> str:
        """How far a run that is not complete has come."""
        return f"{self.last.train_seconds:.0f} s so far" if self.last else "not scored yet"
