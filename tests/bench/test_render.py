from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from nerfreg.bench.configured import TINY
from nerfreg.bench.render import after_the_first, measure
from nerfreg.cli import main
from nerfreg.rendering.views import ViewRenderer
from nerfreg.runs.load import load_run

KEYS = {
    "run", "scene", "reg", "seconds_per_view", "seconds_p10", "seconds_p90", "views", "width",
    "height",
    "points_per_ray", "colors_per_ray", "occupancy_seconds", "first_view_seconds", "threads",
    "peak_memory_mb",
}  # fmt: skip


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    small = [
        "scene.size=24",
        "scene.height=16",
        "scene.views=3",
        "scene.test_views=2",
        "train.threads=1",
    ]
    small += ["sampler.skip_resolution=16", "train.steps=3", "train.quiet=true", "eval.lpips=false"]
    assert main(["train", *TINY, *small, "+reg=annealing", "hydra.run.dir=run"]) == 0
    return Path("run")


def test_the_last_line_is_json(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["bench", "render", "run", "--views", "3", "-o", "out"]) == 0
    record = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert set(record) == KEYS
    expected = {
        "run": "run",
        "scene": "procedural-orbit",
        "reg": ["annealing"],
        "views": 3,
        "threads": 1,
    }
    assert {key: record[key] for key in expected} == expected
    assert (record["width"], record["height"]) == (24, 16)
    assert json.loads(Path("out/render.json").read_text()) == record
    assert sorted(path.name for path in Path().iterdir()) == ["out", "run"]


def test_evaluations_are_those_of_the_timed_views(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = load_run(run)
    scene = loaded.scene
    seen: list[int] = []

    def view(self: ViewRenderer, cameras, view: int, stride: int = 1) -> None:
        seen.append(view)
        self._points.append(24 * 16 * (1000 if len(seen) == 1 else len(seen)))
        self._colors.append(24 * 16)

    monkeypatch.setattr(ViewRenderer, "view", view)
    measured = measure(loaded.trained, 3)
    # The first view is not counted; the next three cost 2, 3 and 4 densities a ray.
    first, second = scene.test
    assert seen == [first, second, first, second]
    assert (measured["points_per_ray"], measured["colors_per_ray"]) == (3.0, 1.0)
    assert not torch.is_inference_mode_enabled()


def test_views_go_round() -> None:
    assert after_the_first([3, 4, 5], 2) == [4, 5]
    assert after_the_first([3, 4, 5], 5) == [4, 5, 3, 4, 5]
    assert after_the_first([3], 2) == [3, 3]


def test_refuses_what_is_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "render", str(tmp_path)]) == 2
    assert "not the folder of a run" in capsys.readouterr().err
