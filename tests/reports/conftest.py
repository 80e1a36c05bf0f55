"""Run folders made by hand, as a run would leave them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

FERN = {"path": "data/fern", "views": 3, "format": "llff", "split": "llff", "held_out": None}


@pytest.fixture
def write_run(tmp_path: Path) -> Callable[..., Path]:
    """Write a run of fern with 3 views, given (seconds, PSNR) of evaluations; the last is final.

    complete=False leaves out `results.json`. Every other keyword is a key of `results.json`.
    """

    def write_run(
        name: str,
        overrides: Sequence[str] = (),
        evaluations: Sequence[tuple[float, float | None]] = ((10.0, 15.0), (100.0, 20.0)),
        seed: int = 0,
        complete: bool = True,
        config: dict[str, Any] | None = None,
        scene: dict[str, Any] | None = None,
        **results: Any,
    ) -> Path:
        folder = tmp_path / name
        (folder / ".hydra").mkdir(parents=True)
        whole = {
            "name": None,
            "seed": seed,
            "scene": {**FERN, **(scene or {})},
            "train": {"steps": None, "seconds": 100.0, "threads": 1, "quiet": True},
            "eval": {"pixels_stride": 4},
            "reg": {},
            **(config or {}),
        }
        (folder / ".hydra" / "config.yaml").write_text(yaml.safe_dump(whole))
        (folder / ".hydra" / "overrides.yaml").write_text(
            yaml.safe_dump([*overrides, f"seed={seed}"])
        )
        lines: list[dict[str, Any]] = []
        for index, (seconds, psnr) in enumerate(evaluations):
            last = complete and index == len(evaluations) - 1
            views = {f"image{view:03}": {"psnr": psnr} for view in range(3 if last else 2)}
            lines.append(
                {
                    "step": int(10 * seconds),
                    "train_seconds": seconds,
                    "psnr": psnr,
                    "ssim": 0.5 if last else None,
                    "lpips": 0.25 if last else None,
                    "average": 0.125 if last else None,
                    "depth_rmse": None,
                    "points_per_second": 2e6,
                    "test_views": views,
                }
            )
        if lines:
            (folder / "metrics.jsonl").write_text(
                "".join(json.dumps(line) + "\n" for line in lines)
            )
        if complete:
            held_out = whole["scene"]["held_out"]
            about = {
                "scene": Path(whole["scene"]["path"]).name,
                "views": whole["scene"]["views"] - len(held_out or ()),
                "held_out": held_out is not None,
                "seed": seed,
                "threads": 1,
                "peak_memory_mb": 500,
                "regularizers": whole["reg"],
                "versions": {"nerfreg": "0.5", "torch": "2.6"},
            }
            (folder / "results.json").write_text(json.dumps({**lines[-1], **about, **results}))
        return folder

    return write_run
