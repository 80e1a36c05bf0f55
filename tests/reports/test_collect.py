"""Reading run folders, whole and otherwise."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from nerfreg.errors import NerfregError
from nerfreg.reports.collect import collect
from nerfreg.reports.records import Setting
from nerfreg.runs.records import EvaluationRecord


def test_a_complete_run(write_run: Callable[..., Path]) -> None:
    folder = write_run(
        "a",
        ["+reg=kl", "sampler=importance"],
        config={"reg": {"kl": {"weight": "${kl_by_layout:weight}"}}},
        regularizers={"kl": {"weight": 1e-5}},
    )
    (run,) = collect([folder])
    # as conftest.py writes it: 10 steps a second, the subset has 2 of the 3 views
    way = EvaluationRecord(100, 10.0, 15.0, None, None, None, None, views=2, whole=False)
    final = EvaluationRecord(1000, 100.0, 20.0, 0.5, 0.25, 0.125, None, views=3, whole=True)
    assert run.evaluations == (way, final) and run.final == final
    assert (run.method, run.seed) == ("kl, sampler=importance", 0)
    assert run.setting == Setting("fern", 3, False)
    assert (run.threads, run.points_per_second, run.peak_memory_mb) == (1, 2e6, 500.0)
    assert run.settings["train.seconds"] == 100.0 and run.settings["reg.kl.weight"] == 1e-5
    assert run.command == ("+reg=kl", "sampler=importance", "seed=0")
    assert run.failure is None and run.versions == {"nerfreg": "0.5", "torch": "2.6"}


def test_a_line_that_is_half_written(write_run: Callable[..., Path]) -> None:
    folder = write_run("a", evaluations=((1.0, 10.0), (2.0, 11.0), (4.0, 12.0)), complete=False)
    text = (folder / "metrics.jsonl").read_text()
    (folder / "metrics.jsonl").write_text(text[:-40])
    (run,) = collect([folder])
    assert [evaluation.psnr for evaluation in run.evaluations] == [10.0, 11.0]
    assert run.final is None and run.points_per_second is None
    # all that results.json would say is found in the configuration
    assert (run.setting, run.seed, run.threads) == (Setting("fern", 3), 0, 1)


def test_a_torn_line_does_not_undo_a_complete_run(write_run: Callable[..., Path]) -> None:
    folder = write_run("a")
    (folder / "metrics.jsonl").write_text((folder / "metrics.jsonl").read_text()[:-9])
    (run,) = collect([folder])
    assert run.final is not None and [evaluation.step for evaluation in run.evaluations] == [
        100,
        1000,
    ]


def test_results_alone_are_a_run(write_run: Callable[..., Path]) -> None:
    folder = write_run("a")
    (folder / "metrics.jsonl").unlink()
    (run,) = collect([folder])
    assert run.final is not None and run.evaluations == (run.final,)


def test_nothing_but_a_configuration(write_run: Callable[..., Path]) -> None:
    write_run("a", evaluations=(), complete=False)
    (run,) = collect([write_run("b", evaluations=(), complete=False).parent])[:1]
    assert run.evaluations == () and run.final is None and run.failure is None


def test_a_repetition_in_the_same_folder_is_not_complete(write_run: Callable[..., Path]) -> None:
    folder = write_run("a")
    first = (folder / "metrics.jsonl").read_text().splitlines()[0]
    (folder / "metrics.jsonl").write_text(
        first + "\n"
    )  # the second run is at step 100, results.json is the first's
    (run,) = collect([folder])
    assert run.final is None and [evaluation.step for evaluation in run.evaluations] == [100]


def test_nulls_are_none(write_run: Callable[..., Path]) -> None:
    (run,) = collect(
        [write_run("a", evaluations=((1.0, None), (2.0, 9.0)), lpips=None, peak_memory_mb=None)]
    )
    assert run.evaluations[0].psnr is None and run.peak_memory_mb is None
    assert run.final is not None and run.final.lpips is None


def test_garbage_is_left_out(write_run: Callable[..., Path]) -> None:
    folder = write_run("a", complete=False)
    (folder / "metrics.jsonl").write_bytes(
        b"\xff\xfe\n[1]\n3\nnull\n{}\n" + (folder / "metrics.jsonl").read_bytes()
    )
    (folder / "results.json").write_text("{")
    (folder / ".hydra" / "overrides.yaml").write_text("")
    (run,) = collect([folder])
    assert [evaluation.step for evaluation in run.evaluations] == [100, 1000] and run.final is None
    (folder / ".hydra" / "config.yaml").write_text("a: [")
    (run,) = collect([folder])
    assert (run.setting, run.method) == (Setting("scene", 0), "vanilla")


def test_full_size_evaluations_of_all_views_are_whole(write_run: Callable[..., Path]) -> None:
    folder = write_run("a", config={"eval": {"pixels_stride": 1}})
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    lines[0]["test_views"] = lines[1]["test_views"]
    (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (run,) = collect([folder])
    assert [evaluation.whole for evaluation in run.evaluations] == [True, True]


def test_a_failed_run_tells_why_and_is_not_complete(write_run: Callable[..., Path]) -> None:
    folder = write_run("a")
    (folder / "failed.json").write_text(
        json.dumps({"error": "NerfregError", "message": "scene.path=x:\n  does not exist"})
    )
    os.utime(folder / "results.json", (1, 1))
    (run,) = collect([folder])
    assert run.failure == "NerfregError: scene.path=x: does not exist" and run.final is None
    os.utime(folder / "failed.json", (0, 0))  # repeated since, and complete
    (run,) = collect([folder])
    assert run.failure is None and run.final is not None
    (folder / "failed.json").write_text("{")
    (run,) = collect([folder])
    assert run.failure == f"see {folder / 'failed.json'}"


def test_searching_finds_each_run_once_in_the_order_of_jobs(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    for name in ("sweep/10_c", "sweep/2_b", "sweep/1_a", "single"):
        write_run(name)
    (tmp_path / "sweep" / "1_a" / "renders" / ".hydra").mkdir(parents=True)
    (tmp_path / "sweep" / "1_a" / "renders" / ".hydra" / "config.yaml").write_text("")
    looked_at = tmp_path / "looked"  # what `nerfreg scene` leaves
    (looked_at / ".hydra").mkdir(parents=True)
    (looked_at / ".hydra" / "config.yaml").write_text("")
    (looked_at / "cameras.png").write_text("")
    runs = collect([tmp_path / "sweep", tmp_path])
    assert [run.folder.name for run in runs] == ["1_a", "2_b", "10_c", "single"]


def test_no_run_and_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(NerfregError, match="no run found"):
        collect([tmp_path])
    with pytest.raises(NerfregError, match="nowhere: does not exist"):
        collect([tmp_path / "nowhere"])
    with pytest.raises(NerfregError, match="file: is a file"):
        collect([tmp_path / "file"])


@pytest.mark.parametrize(
    ("scene", "name"),
    [
        ({"path": None, "format": "procedural", "layout": "forward"}, "procedural-forward"),
        ({"path": None, "format": "procedural", "layout": None}, "procedural-orbit"),
        ({"path": None, "format": "procedural", "layout": "orbit"}, "procedural-orbit"),
        ({"path": None, "format": "procedural", "layout": "object"}, "procedural-orbit"),
        ({"path": "data/mine/transforms.json", "format": "transforms"}, "mine"),
        ({"path": "data/mine/", "format": "transforms"}, "mine"),
    ],
)
def test_the_name_of_a_scene_before_there_are_results(
    write_run: Callable[..., Path], scene, name
) -> None:
    (run,) = collect([write_run("a", scene=scene, complete=False)])
    assert run.setting.scene == name


def test_views_are_known_from_another_run(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("a")
    write_run("b", seed=1, scene={"views": None}, complete=False)
    assert [run.setting.views for run in collect([tmp_path])] == [3, 3]


def test_held_out_views_do_not_train(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("a", scene={"held_out": [0]})
    write_run("b", scene={"held_out": [0]}, seed=1, complete=False)
    assert [run.setting for run in collect([tmp_path])] == [Setting("fern", 2, True)] * 2
