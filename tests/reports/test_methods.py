"""What runs are called."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nerfreg.reports.collect import collect
from nerfreg.reports.methods import method_of


@pytest.mark.parametrize(
    ("overrides", "settings", "method"),
    [
        ([], {}, "vanilla"),
        (["+reg=vanilla"], {}, "vanilla"),
        (["+reg=combinerf"], {"reg.kl.weight": 1e-5}, "combinerf"),
        (["+reg=[kl]"], {"reg.kl.weight": 1e-5}, "kl"),
        # one method, whatever the order in which it was asked for
        (["+reg=[lipschitz,kl]"], {}, "kl+lipschitz"),
        (["+reg=[kl, lipschitz]"], {}, "kl+lipschitz"),
        (["+reg=combinerf", "sampler=importance"], {}, "combinerf, sampler=importance"),
        (["+reg=combinerf", "+experiment=paper_llff"], {}, "combinerf, experiment=paper_llff"),
        # an experiment may select regularizers itself
        (["+experiment=mine"], {"reg.kl.weight": 1.0, "reg.distortion.weight": 1.0},
         "distortion+kl, experiment=mine"),
        # the value that was understood, and no prefix that every regularizer has
        (["+reg=kl", "reg.kl.weight=1e-4"], {"reg.kl.weight": 0.0001}, "kl, kl.weight=0.0001"),
        (["train.rays=2048", "field.levels=8"], {}, "vanilla, field.levels=8, train.rays=2048"),
        # neither scene, seed, threads, budget, scoring nor output
        (
            ["scene=llff", "scene.path=x=y", "scene.views=3", "scene.factor=8",
             "scene.held_out=[0]", "seed=3", "train.threads=1", "train.quiet=true",
             "train.check=true", "train.seconds=60", "train.steps=null",
             "eval.count=3", "eval=fast", "hydra.run.dir=x", "hydra/launcher=joblib", "device=cpu"],
            {}, "vanilla",
        ),
        (["scene.near=0.5"], {"scene.near": 0.5}, "vanilla, scene.near=0.5"),
        (["+reg=combinerf", "~reg.kl"], {}, "combinerf, ~reg.kl"),
        # Hydra's sweeper writes it so.
        (["+reg=combinerf", "~reg.kl=null"], {}, "combinerf, ~reg.kl"),
        (["+reg=combinerf", "sampler=importance", "name=ours"], {"name": "ours"}, "ours"),
        # a plugin under another name, and one of a package whose name another has
        (["+reg=[kl,kl@far]", "reg.far.weight=2"], {"reg.far.weight": 2.0},
         "kl+kl@far, far.weight=2"),
        ([], {"reg.kl.plugin": "kl", "reg.far.plugin": "kl", "reg.far.weight": 1.0}, "kl+kl@far"),
        ([], {"reg.kl.plugin": "foo:kl", "reg.x.plugin": "foo:kl"}, "foo:kl+foo:kl@x"),
        (["+reg=[kl@a,foo\\:kl]"], {}, "foo:kl+kl@a"),
        # a schedule as it was understood
        (
            ["+reg=kl", "reg.kl.weight={schedule: linear, from: 1e-03, to: 0, start: 0}"],
            {"reg.kl.weight": {"schedule": "linear", "from": 0.001, "to": 0.0}},
            "kl, kl.weight={schedule:linear,from:0.001,to:0}",
        ),
        (
            ["+reg=kl", "reg.kl.weight={schedule:piecewise,points:[[0,1],[1,0]]}"],
            {"reg.kl.weight": {"schedule": "piecewise", "points": [[0.0, 1.0], [1.0, 0.0]]}},
            "kl, kl.weight={schedule:piecewise,points:[[0,1],[1,0]]}",
        ),
    ],
)  # fmt: skip
def test_the_method_of_a_run(overrides: list[str], settings: dict[str, Any], method: str) -> None:
    assert method_of(overrides, settings) == method


def methods(folder: Path) -> list[str]:
    return [run.method for run in collect([folder])]


def test_what_all_runs_of_a_scene_share_is_not_named(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    paper = ["+experiment=paper_llff", "train.rays=512"]
    write_run("a", paper)
    write_run("b", [*paper, "+reg=kl"], config={"reg": {"kl": {"weight": 1.0}}})
    write_run("c", [*paper, "sampler=light"])
    runs = collect([tmp_path])
    assert [run.method for run in runs] == ["vanilla", "kl", "vanilla, sampler=light"]
    assert {run.shared for run in runs} == {("experiment=paper_llff", "train.rays=512")}


def test_a_single_method_keeps_its_name(write_run: Callable[..., Path], tmp_path: Path) -> None:
    for seed in (0, 1):
        write_run(f"{seed}", ["sampler=importance"], seed=seed)
    runs = collect([tmp_path])
    assert {(run.method, run.shared) for run in runs} == {("vanilla, sampler=importance", ())}


def train(**keys: Any) -> dict[str, Any]:
    return {"train": {"steps": None, "seconds": 100.0, "threads": 1, **keys}}


def test_budgets_are_named_where_they_differ(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    write_run("a")
    write_run("b", ["train.seconds=600"], config=train(seconds=600.0))
    write_run("c", ["train.steps=1500"], config=train(steps=1500))
    assert methods(tmp_path) == ["vanilla, 100 s", "vanilla, 600 s", "vanilla, 1500 steps or 100 s"]


def test_scenes_may_have_budgets_of_their_own(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    write_run("a")
    write_run("b", config=train(seconds=600.0), scene={"path": "data/room"})
    assert methods(tmp_path) == ["vanilla", "vanilla"]


def kl(weight: object) -> dict[str, Any]:
    return {"reg": {"kl": {"weight": weight, "density": "weights"}}}


def test_one_name_for_two_configurations_is_made_two(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    # the preset's file was changed between the runs
    write_run("a", ["+reg=mine"], config=kl(1e-5))
    write_run("b", ["+reg=mine"], config=kl(2e-5))
    write_run("c", ["+reg=mine"], config=kl(2e-5), seed=1)
    assert methods(tmp_path) == [
        "mine (kl.weight=1e-05)",
        "mine (kl.weight=2e-05)",
        "mine (kl.weight=2e-05)",
    ]


def test_schedules_set_methods_apart(write_run: Callable[..., Path], tmp_path: Path) -> None:
    for name, last in (("a", 0.0), ("b", 1e-5)):
        write_run(name, ["+reg=mine"], config=kl({"schedule": "linear", "from": 1e-3, "to": last}))
    assert methods(tmp_path) == [
        "mine (kl.weight={schedule:linear,from:0.001,to:0})",
        "mine (kl.weight={schedule:linear,from:0.001,to:1e-05})",
    ]


def test_a_run_that_does_not_say_which_plugin_it_used_is_the_same_method(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    write_run("a", ["+reg=kl"], config=kl(1e-5))
    write_run("b", ["+reg=kl"], config={"reg": {"kl": {**kl(1e-5)["reg"]["kl"], "plugin": "kl"}}})
    assert methods(tmp_path) == ["kl", "kl"]


def test_a_variant_has_the_same_name_on_all_scenes(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    write_run("a", ["+reg=mine"], config=kl(1e-5))
    write_run("b", ["+reg=mine"], config=kl(2e-5))
    write_run("c", ["+reg=mine"], config=kl(2e-5), scene={"path": "data/room"})
    assert methods(tmp_path)[1:] == ["mine (kl.weight=2e-05)", "mine (kl.weight=2e-05)"]


def test_weights_may_depend_on_the_scene(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("a", ["+reg=mine"], config=kl(1e-5))
    write_run("c", ["+reg=mine"], config=kl(2e-5), scene={"path": "data/room"})
    assert methods(tmp_path) == ["mine", "mine"]


def test_the_name_of_a_study_is_no_method(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("a", ["name=study", "+reg=kl", "train.rays=8"], config={"name": "study", **kl(1.0)})
    write_run("b", ["name=study", "train.rays=8"], config={"name": "study"})
    write_run("c", ["name=ours", "sampler=x"], config={"name": "ours"})
    write_run("d", ["name=ours", "sampler=x"], config={"name": "ours"}, seed=1)
    assert methods(tmp_path) == ["kl", "vanilla", "ours", "ours"]


def test_a_users_name_for_two_configurations_is_made_two(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    write_run("a", ["name=x", "+reg=mine"], config={"name": "x", **kl(1.0)})
    write_run("b", ["name=x", "+reg=mine"], config={"name": "x"})
    assert methods(tmp_path) == ["x (reg=kl)", "x (reg=vanilla)"]


def test_versions_and_threads_set_apart(write_run: Callable[..., Path], tmp_path: Path) -> None:
    write_run("a")
    write_run("b", versions={"nerfreg": "0.6", "torch": "2.6"})
    assert methods(tmp_path) == [
        "vanilla (version of nerfreg=0.5)",
        "vanilla (version of nerfreg=0.6)",
    ]
    write_run("c", threads=2)
    assert methods(tmp_path)[2] == "vanilla (threads=2, version of nerfreg=0.5)"


def test_what_is_not_known_sets_nothing_apart(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    # a run that is being written knows neither versions nor resolved weights; an older one lacks
    # a key
    write_run("a", ["+reg=kl"], config=kl(1e-5))
    write_run("b", ["+reg=kl"], seed=1, config=kl("${kl_by_layout:weight}"), complete=False)
    write_run("c", ["+reg=kl"], seed=2, config={"reg": {"kl": {"weight": 1e-5}}})
    assert methods(tmp_path) == ["kl"] * 3


def test_many_differences_are_numbered(write_run: Callable[..., Path], tmp_path: Path) -> None:
    for name, value in (("a", 1), ("b", 2), ("c", 1)):
        write_run(name, config={"field": {key: value for key in "abcd"}}, seed=ord(name))
    assert methods(tmp_path) == [
        "vanilla (variant 1)",
        "vanilla (variant 2)",
        "vanilla (variant 1)",
    ]


def test_scenes_that_are_not_the_same_photographs_are_two(
    write_run: Callable[..., Path], tmp_path: Path
) -> None:
    write_run("a", scene={"factor": 4})
    write_run("b", scene={"factor": 8})
    write_run("c", scene={"factor": 8, "views": 6})
    assert [run.setting.scene for run in collect([tmp_path])] == [
        "fern (factor=4)",
        "fern (factor=8)",
        "fern",
    ]


def test_folds_are_not_seeds(write_run: Callable[..., Path], tmp_path: Path) -> None:
    for fold in (0, 1):
        write_run(f"{fold}", scene={"held_out": [fold]})
    assert [run.setting.scene for run in collect([tmp_path])] == [
        "fern (held_out=[0])",
        "fern (held_out=[1])",
    ]
