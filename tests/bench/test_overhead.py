from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from matplotlib.image import imread
from rich.console import Console

from nerfreg.bench import configured, overhead
from nerfreg.bench.configured import TINY, TimedSteps
from nerfreg.bench.overhead import (
    LIMITS,
    NO_MANAGER,
    OverheadPoint,
    OverheadSizes,
    Variant,
    choose,
    compare,
    measure,
    start_alike,
    summarize,
    tabulate,
    verdict,
)
from nerfreg.cli import main
from nerfreg.config.compose import compose
from nerfreg.errors import NerfregError
from nerfreg.scenes import load_scene
from nerfreg.training.trainer import Trainer

SCENE = ("scene.size=24", "scene.views=3", "scene.test_views=2", "train.threads=1")
KL = Variant("kl", "plugin")


def point(variant: str, share: float, ratio: float) -> OverheadPoint:
    return OverheadPoint(
        variant, "plugin", share, ratio, 1.0, ratio, ratio - 0.1, ratio + 0.1, 3, 20.0, 10.0
    )


def test_all_plugins_and_presets_and_no_manager() -> None:
    kinds = {variant.name: variant.kind for variant in choose(())}
    assert kinds[NO_MANAGER] == "core"
    assert {name for name, kind in kinds.items() if kind == "plugin"} >= {
        "kl",
        "lipschitz",
        "annealing",
        "adversarial",
    }
    assert {name for name, kind in kinds.items() if kind == "preset"} >= {
        "combinerf",
        "combinerf_sharp",
        "ablation_lip",
    }
    assert "vanilla" not in kinds
    assert set(LIMITS) <= set(kinds)


def test_some_of_them() -> None:
    assert [variant.name for variant in choose(("combinerf", "kl"))] == ["kl", "combinerf"]
    with pytest.raises(
        NerfregError,
        match="--only combinrf: no installed plugin or preset; did you mean 'combinerf'",
    ):
        choose(("kl", "combinrf"))


def test_ratio_of_each_round_to_vanilla_in_the_same_round() -> None:
    # Ratios 2, 2, 2, 2, 7: the machine's slow third round falls on both. The median of the times
    # would say 2 as well, their quantiles not: linear interpolation puts 90 % of five values 0.6 of
    # the way from the fourth to the fifth.
    own, vanilla = [2.0, 4.0, 20.0, 6.0, 7.0], [1.0, 2.0, 10.0, 3.0, 1.0]
    compared = compare(KL, 0.25, TimedSteps(own, 300.0), TimedSteps(vanilla, 100.0))
    assert (compared.variant, compared.kind, compared.share, compared.rounds) == (
        "kl",
        "plugin",
        0.25,
        5,
    )
    assert (compared.milliseconds, compared.vanilla_milliseconds) == (6000.0, 2000.0)
    assert (compared.ratio, compared.ratio_p10, compared.ratio_p90) == (
        2.0,
        2.0,
        pytest.approx(5.0),
    )
    assert (compared.points, compared.vanilla_points) == (300.0, 100.0)


def test_summary_is_the_mean_over_the_shares() -> None:
    points = [
        point("kl", 0.1, 1.0),
        point("mask", 0.1, 0.5),
        point("kl", 0.9, 1.4),
        point("mask", 0.9, 0.9),
    ]
    kl, mask = summarize(points)
    assert (kl.variant, mask.variant) == ("kl", "mask")
    assert (kl.ratio, kl.ratio_p10, kl.ratio_p90) == pytest.approx((1.2, 1.1, 1.3))
    assert mask.ratio == pytest.approx(0.7)
    assert kl.points / kl.vanilla_points == 2.0


def test_limits_have_two_digits() -> None:
    assert verdict(point("distortion", 0.5, 1.034)) == ("1.03", "")
    assert verdict(point("distortion", 0.5, 1.036)) == ("1.03", "missed")
    assert verdict(point(NO_MANAGER, 0.5, 0.976)) == ("0.98-1.02", "")
    assert verdict(point(NO_MANAGER, 0.5, 0.974)) == ("0.98-1.02", "missed")
    assert verdict(point("occlusion", 0.5, 9.0)) == ("", "")


def test_table_names_ratio_limit_and_what_misses_it(capsys: pytest.CaptureFixture[str]) -> None:
    points = [
        point("combinerf", 0.5, 1.234),
        point("distortion", 0.5, 1.01),
        point("occlusion", 0.5, 9.0),
    ]
    sizes = OverheadSizes(shares=(0.5,), steps=3, warmup=1)
    Console().print(tabulate(points, compose(()), "nowhere", sizes))
    lines = {
        line.split()[0]: line.split()[1:]
        for line in capsys.readouterr().out.splitlines()
        if line.strip()
    }
    assert lines["combinerf"] == ["1.234", "1.13-1.33", "2.00", "1.15", "missed"]
    assert lines["distortion"] == ["1.010", "0.91-1.11", "2.00", "1.03"]
    assert lines["occlusion"] == ["9.000", "8.90-9.10", "2.00"]


def test_variants_take_turns_with_vanilla_at_every_share(
    monkeypatch: pytest.MonkeyPatch, clock: SimpleNamespace
) -> None:
    config = compose((*TINY, *SCENE))
    scene = load_scene(config.scene)
    order: list[tuple[str, float]] = []

    def step_at(trainer: Trainer, share: float) -> None:
        name = "+".join(trainer.hooks.plugins) or "vanilla"
        order.append((name, share))
        # kl takes three times as long as vanilla, and the machine is ten times slower from the
        # fourth round on.
        clock.now += (3.0 if name == "kl" else 1.0) * (10.0 if len(order) > 9 else 1.0)

    monkeypatch.setattr(configured, "step_at", step_at)
    monkeypatch.setattr(overhead, "SETTLING", 1)
    sizes = OverheadSizes(shares=(0.1, 0.9), steps=2, warmup=1)
    group = [KL, Variant("distortion", "plugin")]
    points = list(measure(group, (*TINY, *SCENE), scene, sizes))
    names = ["vanilla", "kl", "distortion"]
    # One round to warm up, or to settle, and two that are timed.
    assert order == [(name, share) for share in (0.1, 0.9) for _ in range(3) for name in names]
    assert [(p.variant, p.share, p.ratio) for p in points] == [
        ("kl", 0.1, 3.0), ("distortion", 0.1, 1.0), ("kl", 0.9, 3.0), ("distortion", 0.9, 1.0),
    ]  # fmt: skip


def test_all_start_with_the_same_weights(make: Callable[..., Trainer]) -> None:
    vanilla = make()
    # Biases draw random numbers of their own, so that without help the next layer's weights would
    # differ.
    biased = make("+reg=lipschitz", "reg.lipschitz.bias=true")
    theirs, own = dict(vanilla.field.named_parameters()), dict(biased.field.named_parameters())
    assert not torch.equal(
        own["density_network.layers.1.weight"], theirs["density_network.layers.1.weight"]
    )
    start_alike(biased, vanilla)
    assert {name.rpartition(".")[2] for name in set(own) - set(theirs)} == {"k", "bias"}
    assert all(torch.equal(own[name], theirs[name]) for name in theirs)


def test_without_manager_is_vanilla(make: Callable[..., Trainer]) -> None:
    vanilla = make()
    bare = Variant(NO_MANAGER, "core").trainer((*TINY, *SCENE), vanilla.scene)
    for _ in range(3):
        assert [float(term.value) for term in vanilla.step()] == [
            float(term.value) for term in bare.step()
        ]


def test_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert (
        main(
            [
                "bench",
                "overhead",
                "--quick",
                *SCENE,
                "--only",
                "annealing,ablation_lip",
                "-o",
                "out",
            ]
        )
        == 0
    )
    assert capsys.readouterr().out.splitlines()[-3:] == [
        f"out/overhead.{end}" for end in ("csv", "png", "svg")
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]
    assert imread("out/overhead.png").shape[1] >= 1200
    with Path("out/overhead.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert list(lines[0]) == [
        "variant", "kind", "share", "milliseconds", "vanilla_milliseconds", "ratio", "ratio_p10",
        "ratio_p90", "rounds",
        "points", "vanilla_points",
    ]  # fmt: skip
    assert [(line["variant"], line["kind"], line["share"]) for line in lines] == [
        ("annealing", "plugin", "0.05"), ("ablation_lip", "preset", "0.05"),
        ("annealing", "plugin", "0.5"), ("ablation_lip", "preset", "0.5"),
    ]  # fmt: skip
    assert {line["points"] for line in lines} == {"1024"}  # 64 rays of 8 + 8 samples


def test_refuses_a_choice_of_plugins(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "overhead", "+reg=kl"]) == 2
    assert "+reg=kl: bench overhead selects plugins itself" in capsys.readouterr().err
