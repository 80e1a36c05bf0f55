from __future__ import annotations

import csv
from pathlib import Path

import pytest
from matplotlib.image import imread

from nerfreg.bench import losses, quadrature
from nerfreg.cli import main

FORMS = {
    ("depth_smoothness", "plugin"),
    ("distortion", "all pairs"),
    ("distortion", "plugin"),
    ("distortion", "prefix sums"),
    ("entropy", "+ 1e-10"),
    ("entropy", "1 - exp(-tau)"),
    ("entropy", "plugin"),
    ("full_geometry", "1 - sum w"),
    ("full_geometry", "plugin"),
    ("kl", "+ 1e-10"),
    ("kl", "plugin"),
    ("occlusion", "plugin"),
}


def bench(
    capsys: pytest.CaptureFixture[str], name: str, *words: str
) -> tuple[str, list[dict[str, str]], Path]:
    """Return what a bench prints, the lines of its CSV file, and the folder of its files."""
    assert main(["bench", name, "--quick", *words]) == 0
    out = capsys.readouterr().out
    paths = [Path(line) for line in out.splitlines()[-3:]]
    assert [path.name for path in paths] == [f"{name}.csv", f"{name}.png", f"{name}.svg"]
    assert imread(paths[1]).shape[1] >= 1200
    assert "<svg" in paths[2].read_text(encoding="utf-8")[:1000]
    with paths[0].open(encoding="utf-8", newline="") as file:
        return out, list(csv.DictReader(file)), paths[0].parent


def test_quadrature(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    out, points, folder = bench(capsys, "quadrature")
    assert folder == Path("bench", "quadrature")
    # 11 media, 4 samplers, one more for the 2 media with gaps; 2 precisions.
    assert len(points) == 92 * len(quadrature.QUICK.samples)
    assert list(points[0])[:6] == [
        "medium",
        "sampler",
        "dtype",
        "samples",
        "evaluations",
        "microseconds",
    ]
    errors = [
        f"{quantity}_error{end}"
        for quantity in ("opacity", "depth", "color")
        for end in ("", "_p10", "_p90")
    ]
    assert list(points[0])[6:] == errors
    for point in points:
        assert float(point["microseconds"]) > 0
        assert all(float(point[error]) >= 0 for error in errors)
    assert "one thread" in " ".join(out.split())


def test_losses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, points, folder = bench(capsys, "losses", "-o", str(tmp_path / "elsewhere"))
    assert folder == tmp_path / "elsewhere"
    assert {(point["plugin"], point["form"]) for point in points} >= FORMS
    assert list(points[0]) == [
        "plugin", "form", "input", "samples", "relative_error", "milliseconds", "value", "exact",
        "exact_rays", "rays",
    ]  # fmt: skip
    own = [point for point in points if point["form"] == "plugin"]
    # 4 inputs for each of 6 plugins and each size.
    assert len([point for point in own if (point["plugin"], "plugin") in FORMS]) == 24 * len(
        losses.QUICK.samples
    )
    # What is promised of losses in float32.
    assert max(float(point["relative_error"]) for point in own) < 1e-5
    assert "one thread" in " ".join(out.split())
    # It renders again, and there is no field to do it with.
    assert "adversarial" in " ".join(out.split()).partition("exact values:")[2]


def test_refuses_a_file_as_folder_before_measuring(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "taken"
    file.touch()
    assert main(["bench", "losses", "-o", str(file)]) == 2
    assert f"-o {file}: is a file" in capsys.readouterr().err
