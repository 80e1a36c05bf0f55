"""`nerfreg report` from the command line's point of view."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from nerfreg.cli import main

PAPER = (
    "dataset,views,scene,method,psnr,ssim,lpips,average\nllff,3,fern,vanilla,17.79,0.509,0.402,\n"
)


def test_a_report(
    write_run: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for seed, psnr in enumerate((20.0, 22.0)):
        write_run(f"runs/{seed}", seed=seed, evaluations=((10.0, 15.0), (100.0, psnr)))
    write_run(
        "runs/kl",
        ["+reg=kl"],
        config={"reg": {"kl": {"weight": 1.0}}},
        evaluations=((10.0, 15.0), (100.0, 23.0)),
    )
    Path("paper.csv").write_text(PAPER)
    assert main(["report", "runs", "-o", "out", "--paper", "paper.csv"]) == 0
    printed = capsys.readouterr().out
    for text in (
        "fern, 3 views",
        "21.00 ± 1.41",
        "vanilla (paper)",
        "17.79",
        "to",
        "out/tables.md",
        "out/runs.csv",
    ):
        assert text in printed, text
    assert "| kl | **23.00** |" in Path("out/tables.md").read_text()
    assert Path("out/report.html").is_file()


def test_a_second_report_into_the_same_folder_shows_the_runs_of_now(
    write_run: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_run("runs/0", evaluations=((10.0, 15.0), (100.0, 20.0)))
    main(["report", "runs", "-o", "out"])
    write_run("runs/1", seed=1, evaluations=((10.0, 5.0), (100.0, 30.0)))
    for folder in ("out", "fresh"):
        main(["report", "runs", "-o", folder])
    assert Path("out/report.html").read_text() == Path("fresh/report.html").read_text()


def test_views_that_no_run_has_leave_no_half_of_a_report(
    write_run: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    write_run("runs/0", evaluations=((10.0, 15.0),))
    assert main(["report", "runs", "-o", "out", "--views", "nowhere"]) == 2
    assert "--views nowhere: no run has a picture of it" in capsys.readouterr().err
    assert not [path for path in Path("out").rglob("*") if path.is_file()]


def test_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path)]) == 2
    assert "no run found" in capsys.readouterr().err
    assert main(["report", str(tmp_path / "nowhere")]) == 2
    assert "nowhere: does not exist" in capsys.readouterr().err
    assert not (tmp_path / "report").exists()
