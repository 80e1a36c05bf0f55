from __future__ import annotations

import csv
from pathlib import Path

import pytest
from matplotlib.image import imread

from nerfreg.bench.scaling import ScalingPoint, changed, fit
from nerfreg.cli import main
from nerfreg.config.compose import compose


def point(value: int, milliseconds: float) -> ScalingPoint:
    return ScalingPoint("rays", value, milliseconds, milliseconds, milliseconds, 1.0)


def test_fit_of_a_power_and_of_a_line() -> None:
    # y = 2 x: slope 1, through the origin.
    slope, line = fit([point(n, 2.0 * n) for n in (1, 2, 4, 8)])
    assert slope == pytest.approx(1)
    assert line == pytest.approx([2, 4, 8, 16])
    # y = 10 + 3 x is a straight line, but no power.
    slope, line = fit([point(n, 10 + 3.0 * n) for n in (1, 10, 100)])
    assert line == pytest.approx([13, 40, 310])
    assert 0 < slope < 1
    # y = x^2 is a power, but no straight line.
    slope, line = fit([point(n, float(n**2)) for n in (1, 2, 4, 8)])
    assert slope == pytest.approx(2)
    assert max(abs(y / n**2 - 1) for n, y in zip((1, 2, 4, 8), line, strict=True)) > 0.1


def test_one_thing_is_swept_at_a_time() -> None:
    sampler = ("sampler.coarse=8", "sampler.fine=8")
    config = compose(("train.rays=100", *sampler, "field.levels=4", "field.log2_entries=9"))

    def sizes(swept: str, value: int) -> tuple[int, ...]:
        c = changed(config, swept, value)
        field = (c.field.levels, c.field.log2_entries)
        return (c.train.rays, c.sampler.coarse, c.sampler.fine, *field)

    assert sizes("rays", 50) == (50, 8, 8, 4, 9)
    assert sizes("samples", 7) == (100, 3, 4, 4, 9)
    assert sizes("levels", 2) == (100, 8, 8, 2, 9)
    assert sizes("entries", 4096) == (100, 8, 8, 4, 12)


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
        ("rays", "32", "512"), ("rays", "64", "1024"),
        ("samples", "8", "512"), ("samples", "16", "1024"),
        ("levels", "2", "1024"), ("levels", "4", "1024"),
        ("entries", "256", "1024"), ("entries", "1024", "1024"),
    ]  # fmt: skip
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bench"]
