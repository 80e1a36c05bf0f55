from __future__ import annotations

import csv
from pathlib import Path

import pytest
from matplotlib.image import imread

from nerfreg.bench.configured import compose
from nerfreg.bench.scaling import Point, Sizes, fit, sweeps
from nerfreg.cli import main


def point(value: int, milliseconds: float) -> Point:
    return Point("rays", value, milliseconds, milliseconds, milliseconds, 1.0)


def test_fit_of_a_power_and_of_a_line() -> None:
    # y = 2 x: slope 1, through the origin.
    line = fit([point(n, 2.0 * n) for n in (1, 2, 4, 8)])
    assert (line.slope, line.fixed, line.each, line.off) == pytest.approx((1, 0, 2, 0), abs=1e-9)
    # y = 10 + 3 x is a straight line, but no power.
    line = fit([point(n, 10 + 3.0 * n) for n in (1, 10, 100)])
    assert (line.fixed, line.each, line.off) == pytest.approx((10, 3, 0), abs=1e-9)
    assert 0 < line.slope < 1
    # y = x^2 is a power, but no straight line.
    square = fit([point(n, float(n**2)) for n in (1, 2, 4, 8)])
    assert square.slope == pytest.approx(2)
    assert square.off > 0.1


def test_one_thing_is_swept_at_a_time() -> None:
    config = compose(
        (
            "train.rays=100",
            "sampler.coarse=8",
            "sampler.fine=8",
            "field.levels=4",
            "field.log2_entries=9",
        )
    )
    sizes = Sizes(rays=(50,), samples=(7,), levels=(2,), log2_entries=(12,), steps=1, warmup=1)
    made = [
        (
            swept,
            value,
            c.train.rays,
            c.sampler.coarse,
            c.sampler.fine,
            c.field.levels,
            c.field.log2_entries,
        )
        for swept, value, c in sweeps(config, sizes)
    ]
    assert made == [
        ("rays", 50, 50, 8, 8, 4, 9),
        ("samples", 7, 100, 3, 4, 4, 9),
        ("levels", 2, 100, 8, 8, 2, 9),
        ("entries", 4096, 100, 8, 8, 4, 12),
    ]


def test_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    small = ["scene.size=24", "scene.views=3", "scene.test_views=2", "train.threads=1"]
    assert main(["bench", "scaling", "--quick", "--steps", "1", *small]) == 0
    paths = [f"bench/scaling/scaling.{end}" for end in ("csv", "png", "svg")]
    assert capsys.readouterr().out.splitlines()[-3:] == paths
    assert imread(paths[1]).shape[1] >= 1200
    with Path(paths[0]).open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert list(lines[0]) == [
        "swept",
        "value",
        "milliseconds",
        "milliseconds_p10",
        "milliseconds_p90",
        "points",
    ]
    # 32 and 64 rays of 16 samples; 64 rays of 8 and 16; 64 x 16 for the rest.
    assert [(line["swept"], line["value"], line["points"]) for line in lines] == [
        ("rays", "32", "512"), ("rays", "64", "1024"), ("samples", "8", "512"), ("samples", "16", "1024"),
        ("levels", "2", "1024"), ("levels", "4", "1024"), ("entries", "256", "1024"), ("entries", "1024", "1024"),
    ]  # fmt: skip
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bench"]
