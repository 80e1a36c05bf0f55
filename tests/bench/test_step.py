from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from nerfreg.bench import step, timing
from nerfreg.bench.configured import TINY, TimedSteps, set_up
from nerfreg.bench.step import measure_ceilings, product_flop, step_flop
from nerfreg.cli import main
from nerfreg.field import FieldConfig, RadianceField
from nerfreg.field.layers import Linear

SCENE = ("scene.size=24", "scene.views=3", "scene.test_views=2", "train.threads=1")
KEYS = {
    "points_per_second", "ms", "ms_p10", "ms_p90", "parts_ms", "points_per_step", "colors_per_step",
    "peak_memory_mb",
    "compile_seconds", "warmup_seconds", "threads", "gflops", "ceiling_network_gflops",
    "ceiling_square_gflops",
    "ceiling_bandwidth_gb_per_second", "arithmetic_share", "at", "scene", "reg", "rays", "samples",
    "log2_entries",
    "levels", "finest",
}  # fmt: skip
BOX = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])


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


def make_layer(
    network: str, index: int, in_features: int, out_features: int, activation: str
) -> Linear:
    return Linear(in_features, out_features, activation)


def test_flop_of_a_product() -> None:
    # Each of 2 x 5 elements is a sum of 3 products: counted as 3 multiplications and 3 additions.
    assert product_flop(2, 3, 5) == 60


def test_flop_of_a_step() -> None:
    # The paper's networks, 32-64-16 and 31-64-64-3: 32*64 + 64*16 = 3072 and 31*64 + 64*64 + 64*3 =
    # 6272 weights. Each takes part in one multiplication and one addition forward, and two of each
    # backward: 6.
    field = RadianceField(FieldConfig(levels=16, finest=32, log2_entries=8), BOX, make_layer)
    assert step_flop(field, points=1000.0, colors=0.0) == 1000 * 6 * 3072
    assert step_flop(field, points=0.0, colors=1.0) == 6 * 6272
    assert step_flop(field, points=32768.0, colors=100.0) == 6 * (32768 * 3072 + 100 * 6272)


def test_biases_are_no_products() -> None:
    def biased(
        network: str, index: int, in_features: int, out_features: int, activation: str
    ) -> torch.nn.Module:
        return torch.nn.Linear(in_features, out_features)

    field = RadianceField(FieldConfig(levels=16, finest=32, log2_entries=8), BOX, biased)
    assert step_flop(field, 1.0, 1.0) == 6 * (3072 + 6272)


def test_rates_are_work_over_the_best_time(monkeypatch: pytest.MonkeyPatch) -> None:
    # A clock by which everything takes 2 seconds.
    ticks = iter(range(1000))
    monkeypatch.setattr(timing, "perf_counter", lambda: 2.0 * next(ticks))
    monkeypatch.setattr(step, "threads", lambda: 1)
    measured = measure_ceilings(square=64, copy_mb=1, repetitions=3)
    assert measured["ceiling_square_gflops"] == 2 * 64**3 / 2 / 1e9
    # One MB is read and one is written.
    assert measured["ceiling_bandwidth_gb_per_second"] == 2 * 2**20 / 2 / 1e9
    # 8 products of 4096 x 64 x 64 for each 64 of `square`.
    assert measured["ceiling_network_gflops"] == 8 * 2 * 4096 * 64 * 64 / 2 / 1e9
