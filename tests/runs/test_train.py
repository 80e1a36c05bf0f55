"""A run by the command line: what it leaves, and what can be done with it afterwards."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import imageio.v3 as iio
import pytest

from nerfreg import __version__
from nerfreg.cli import main

SMALL = [
    "scene.size=32", "scene.views=3", "scene.test_views=2", "field.levels=4", "field.finest=64",
    "sampler.coarse=16", "sampler.fine=16", "field.log2_entries=12", "train.rays=128",
    "train.steps=20", "train.quiet=true", "eval.count=3",
]  # fmt: skip


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    assert main(["train", "+reg=[distortion,lipschitz]", *SMALL, "hydra.run.dir=run"]) == 0
    return tmp_path / "run"


def test_a_run_leaves_what_the_design_lists(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results = json.loads((run / "results.json").read_text())
    wanted = {
        "psnr", "ssim", "lpips", "average", "depth_rmse", "step", "train_seconds",
        "points_per_second", "peak_memory_mb", "seed", "regularizers", "views", "scene", "versions",
        "skipped_steps", "plugins", "notes",
    }  # fmt: skip
    assert wanted <= set(results)
    assert results["skipped_steps"] == 0 and not (run / "nonfinite").exists()
    assert results["step"] == 20 and results["views"] == 3 and results["seed"] == 0
    assert set(results["regularizers"]) == {"distortion", "lipschitz"}
    assert results["plugins"] == {
        name: {"plugin": name, "package": "nerfreg", "version": __version__}
        for name in ("distortion", "lipschitz")
    }
    assert results["points_per_second"] * results["train_seconds"] == pytest.approx(
        20 * 128 * 32, rel=1e-2
    )
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert len(lines) == 3
    assert [line["step"] for line in lines] == sorted({line["step"] for line in lines})
    assert lines[-1]["psnr"] == results["psnr"] and lines[-1]["losses"].keys() == {
        "color",
        "distortion",
    }
    pictures = sorted((run / "renders").iterdir())
    assert [picture.name for picture in pictures] == ["test_3.png", "test_4.png"]
    assert iio.imread(pictures[0]).shape == (32, 4 * 32, 3)


def test_one_thread_means_one_in_a_new_process() -> None:
    """Numba may change torch's number when it starts threads of its own."""
    script = (
        "import numba, torch; from nerfreg.config.schema import Config; "
        "from nerfreg.runs.load import prepare; "
        "c = Config(); c.device = 'cpu'; c.train.threads = 1; prepare(c); "
        "print(torch.get_num_threads(), numba.get_num_threads())"
    )
    made = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert made.stdout.split() == ["1", "1"]


def test_evaluating_the_checkpoint_again_gives_the_same_scores(run: Path) -> None:
    before = json.loads((run / "results.json").read_text())
    assert main(["evaluate", str(run)]) == 0
    after = json.loads((run / "results.json").read_text())
    for key in ("psnr", "ssim", "depth_rmse"):
        assert after[key] == pytest.approx(before[key], rel=1e-6)
    assert after["step"] == 20 and after["regularizers"] == before["regularizers"]


def test_a_run_of_earlier_versions_is_scored_as_it_was(run: Path) -> None:
    before = json.loads((run / "results.json").read_text())
    config = run / ".hydra" / "config.yaml"
    text = config.read_text()
    assert "layout: object" in text
    config.write_text(text.replace("layout: object", "layout: orbit"))
    assert main(["evaluate", str(run)]) == 0
    after = json.loads((run / "results.json").read_text())
    assert after["scene"] == before["scene"] == "procedural-orbit"
    assert after["psnr"] == pytest.approx(before["psnr"], rel=1e-6)
    assert after["regularizers"] == before["regularizers"]


def test_the_kind_of_capture_is_said_where_it_was_found(
    capture: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    small = [word for word in SMALL if not word.startswith(("scene.", "train.quiet"))]
    scene = ["scene=transforms", f"scene.path={capture(3)}", "train.steps=2", "eval.lpips=false"]
    line = (
        "thing: room (opaque photographs around a place); "
        "scene.layout=forward or object overrides\n"
    )
    assert main(["train", *small, *scene]) == 0
    found = capsys.readouterr()
    assert found.err.count(line) == 1 and "room" not in found.out
    assert found.err.index(line) < found.err.index("scoring")
    assert main(["train", *small, *scene, "scene.layout=room"]) == 0
    assert "room" not in capsys.readouterr().err
    assert main(["train", *small, *scene, "train.quiet=true"]) == 0
    assert "room" not in capsys.readouterr().err


def test_a_video_along_an_orbit(run: Path) -> None:
    assert main(["render", str(run), "path=orbit", "frames=3"]) == 0
    for name in ("orbit_color.gif", "orbit_depth.gif"):
        assert iio.imread(run / "renders" / name).shape[:3] == (3, 32, 32)


def test_a_device_that_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["train", *SMALL, "device=nonsense"]) == 2
    assert "device=nonsense: not available here" in capsys.readouterr().err
    assert not list(tmp_path.rglob("results.json"))


@pytest.mark.skipif(
    "NERFREG_DATA" not in os.environ, reason="NERFREG_DATA is not set: no real photographs"
)
@pytest.mark.parametrize(
    "overrides, train, tests",
    [
        (
            [
                "scene=llff",
                "scene.path=${oc.env:NERFREG_DATA}/nerf_llff_data/fern",
                "scene.views=3",
            ],
            ["image001", "image010", "image019"],
            {"image000", "image008", "image016"},
        ),
        (
            [
                "scene=blender",
                "scene.path=${oc.env:NERFREG_DATA}/nerf_synthetic/chair",
                "scene.factor=8",
            ],
            [f"train_r_{i}" for i in (26, 86, 2, 55, 75, 93, 16, 73)],
            {f"test_r_{round(i * 199 / 24)}" for i in range(25)},
        ),
    ],
)
def test_real_photographs_by_the_papers_protocols(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    overrides: list[str],
    train: list[str],
    tests: set[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    small = [word for word in SMALL if not word.startswith("scene.")]
    words = [
        "train",
        "+reg=combinerf",
        *overrides,
        *small,
        "sampler.coarse=8",
        "sampler.fine=8",
        "hydra.run.dir=run",
    ]
    assert main(words) == 0
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert results["train_views"] == train and set(results["test_views"]) == tests
    # the mean over images of each image's PSNR, and the geometric mean of the three errors
    psnrs = [view["psnr"] for view in results["test_views"].values()]
    assert results["psnr"] == pytest.approx(sum(psnrs) / len(psnrs))
    errors = 10 ** (-results["psnr"] / 10) * (1 - results["ssim"]) ** 0.5 * results["lpips"]
    assert results["average"] == pytest.approx(errors ** (1 / 3))
    assert results["depth_rmse"] is None
