from __future__ import annotations

import pytest
import torch

from nerfreg.bench import ceilings, timing
from nerfreg.bench.ceilings import measure_ceilings, product_flop, step_flop
from nerfreg.field import FieldConfig, RadianceField
from nerfreg.field.layers import Linear

BOX = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])


def make_layer(
    network: str, index: int, in_features: int, out_features: int, activation: str
) -> Linear:
    return Linear(in_features, out_features, activation)


def test_flop_of_a_product() -> None:
    # Each of 2 x 5 elements is a sum of 3 products: counted as 3 multiplications and 3 additions.
    assert product_flop(2, 3, 5) == 60


def test_flop_of_a_step() -> None:
    # The paper's networks, 32-64-16 and 31-64-64-3: 32*64 + 64*16 = 3072 and 31*64 + 64*64 + 64*3 = 6272 weights. Each
    # takes part in one multiplication and one addition forward, and two of each backward: 6.
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
    monkeypatch.setattr(ceilings, "threads", lambda: 1)
    measured = measure_ceilings(square=64, copy_mb=1, repetitions=3)
    assert measured["ceiling_square_gflops"] == 2 * 64**3 / 2 / 1e9
    # One MB is read and one is written.
    assert measured["ceiling_bandwidth_gb_per_second"] == 2 * 2**20 / 2 / 1e9
    # 8 products of 4096 x 64 x 64 for each 64 of `square`.
    assert measured["ceiling_network_gflops"] == 8 * 2 * 4096 * 64 * 64 / 2 / 1e9
