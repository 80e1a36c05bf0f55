from __future__ import annotations

import json
from pathlib import Path

import pytest

from nerfreg.bench import step
from nerfreg.bench.configured import TINY, TimedSteps, set_up
from nerfreg.cli import main

SCENE = ("scene.size=24", "scene.views=3", "scene.test_views=2", "train.threads=1")
KEYS = {
    "points_per_second", "ms", "ms_p10", "ms_p90", "parts_ms", "points_per_step", "colors_per_step", "peak_memory_mb",
    "compile_seconds", "warmup_seconds", "threads", "gflops", "ceiling_network_gflops", "ceiling_square_gflops",
    "ceiling_bandwidth_gb_per_second", "arithmetic_share", "at", "scene", "reg", "rays", "samples", "log2_entries",
    "levels", "finest",
}  # fmt: skip


def test_the_last_line_is_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = [
        "+reg=[distortion,lipschitz]",
        *SCENE,
        "sampler.fine=4",
        "--at",
        "0.25",
        "--steps",
        "2",
    ]
    assert main(["bench", "step", "--quick", *words]) == 0
    out = capsys.readouterr().out
    record = json.loads(out.splitlines()[-1])
    assert set(record) == KEYS
    # 64 rays of 8 coarse and 4 fine samples, each evaluated once; a colour is a sample's.
    assert record["samples"] == 12
    assert record["points_per_step"] == 64 * 12
    assert 0 < record["colors_per_step"] <= 64 * 12
    assert record["points_per_second"] == pytest.approx(64 * 12 / record["ms"] * 1e3)
    assert record["ms_p10"] <= record["ms"] <= record["ms_p90"]
    summary = {
        "scene": "procedural-orbit",
        "reg": ["distortion", "lipschitz"],
        "rays": 64,
        "at": 0.25,
        "threads": 1,
    }
    assert {key: record[key] for key in summary} == summary
    assert (record["levels"], record["log2_entries"], record["finest"]) == (4, 10, 32)
    assert {"rays", "sampling", "hash grid", "hash grid backward", "networks", "optimizer"} <= set(
        record["parts_ms"]
    )
    assert "One training step in parts" in out
    # Nothing but its own file: no run folder of Hydra's.
    assert [path.relative_to(tmp_path) for path in tmp_path.rglob("*.*")] == [
        Path("bench/step/step.json")
    ]
    assert json.loads(Path("bench/step/step.json").read_text()) == record


def test_rates_follow_from_what_was_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    ceilings = {"ceiling_network_gflops": 80.0}
    monkeypatch.setattr(step, "time_steps", lambda *_: [TimedSteps([0.1, 0.2, 0.3], 30000.0)])
    monkeypatch.setattr(step, "step_flop", lambda *_: 4e9)
    monkeypatch.setattr(step, "measure_ceilings", lambda *_: ceilings)
    monkeypatch.setattr(step, "peak_memory_mb", lambda: 1.4)
    record = step.measure(*set_up((*TINY, *SCENE)), step.QUICK)
    # 30000 points in 0.2 s; 4 GFLOP in 0.2 s are 20 GFLOP/s, a quarter of what the networks'
    # products reach.
    assert record["ms"] == pytest.approx(200)
    assert record["points_per_second"] == pytest.approx(150000)
    assert record["gflops"] == pytest.approx(20)
    assert record["arithmetic_share"] == pytest.approx(0.25)
    assert record["peak_memory_mb"] == 1
