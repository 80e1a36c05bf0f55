"""`nerfreg bench overhead`: what each regularizer and each preset makes of the time of a step, against vanilla.

Every variant is a short run of its own, from the same weights and the same seed. They take turns step by step, vanilla
among them, so that whatever else the machine does falls on all alike, and move together from share to share of the
budget, because windows and masks follow it.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

import torch
from rich.console import Console
from torch import Tensor, nn

from nerfreg.analysis.tables import Outcome, write_points
from nerfreg.bench.configured import TINY, compose, make_trainer, prepare_cpu, step_at
from nerfreg.bench.timing import in_turns, spread
from nerfreg.config.search_path import options
from nerfreg.errors import NerfregError, nearest
from nerfreg.field.layers import Linear
from nerfreg.hooks import Needs, Rays, Rendering, Samples, Step
from nerfreg.registry import Hooks, Term, installed
from nerfreg.scenes import load_scene
from nerfreg.scenes.scene import Scene
from nerfreg.training.memory import keep_large_blocks
from nerfreg.training.trainer import Trainer

VANILLA = "vanilla"
NO_MANAGER = "no plugin manager"
CORE, PLUGIN, PRESET = "core", "plugin", "preset"


@dataclass(frozen=True)
class Sizes:
    """shares: of the budget, ascending. steps: timed at each share. settling: steps after moving to a share that are
    not timed. warmup: steps before the first. together: variants that are in memory at the same time, beside vanilla.
    only: names of variants; empty: all. defaults: overrides that the command line may override."""

    shares: tuple[float, ...]
    steps: int
    settling: int
    warmup: int
    together: int
    only: tuple[str, ...] = ()
    defaults: tuple[str, ...] = ()


FULL = Sizes((0.05, 0.25, 0.5, 0.75, 0.95), steps=20, settling=5, warmup=60, together=4)
QUICK = Sizes((0.05, 0.5), steps=2, settling=1, warmup=1, together=3, defaults=TINY)


class WithoutManager(Hooks):
    """The core as it would be if there were no plugins to look for."""

    def needs(self, step: Step) -> Needs:
        return Needs()

    def layer(
        self, network: str, index: int, in_features: int, out_features: int, activation: str
    ) -> nn.Module:
        return Linear(in_features, out_features, activation)

    def ray_bounds(self, rays: Rays, step: Step) -> tuple[Tensor, Tensor]:
        return rays.near, rays.far

    def encoder_input(self, samples: Samples, step: Step) -> Samples:
        return samples

    def losses(self, rendering: Rendering, step: Step) -> list[Term]:
        return []


@dataclass(frozen=True)
class Variant:
    """name: of a plugin or preset. kind: "plugin", "preset" or "core". choice: the override that selects it."""

    name: str
    kind: str
    choice: tuple[str, ...] = ()

    def trainer(self, overrides: Sequence[str], scene: Scene) -> Trainer:
        config = compose((*overrides, f"scene.layout={scene.layout}", *self.choice))
        return make_trainer(
            config, scene, WithoutManager() if self.name == NO_MANAGER else Hooks(config.reg)
        )


@dataclass(frozen=True)
class Point:
    """One variant at one share of the budget.

    milliseconds, vanilla_milliseconds: medians. ratio: the median over all rounds of the variant's time to that of
    vanilla in the same round, with quantiles of 10 and 90 %. points, vanilla_points: evaluations of the density a step.
    """

    variant: str
    kind: str
    share: float
    milliseconds: float
    vanilla_milliseconds: float
    ratio: float
    ratio_p10: float
    ratio_p90: float
    rounds: int
    points: float
    vanilla_points: float


def run(folder: Path, sizes: Sizes, overrides: tuple[str, ...]) -> Outcome:
    """Measure all variants, or those of `sizes.only`; print a table; write a CSV file and a plot."""
    from nerfreg.bench.overhead_report import draw, print_table, summarize

    if chosen := next((word for word in overrides if word.lstrip("+~").startswith("reg=")), None):
        raise NerfregError(
            f"{chosen}: bench overhead selects plugins itself; write --only NAME,NAME for some of them"
        )
    keep_large_blocks()
    config = compose((*sizes.defaults, *overrides))
    prepare_cpu(config)
    variants = choose(sizes.only)
    scene = load_scene(config.scene)
    points: list[Point] = []
    with Console(stderr=True).status("") as status:
        for first in range(0, len(variants), sizes.together):
            group = variants[first : first + sizes.together]
            status.update(
                f"{', '.join(variant.name for variant in group)} ({first} of {len(variants)} done)"
            )
            points += measure(group, (*sizes.defaults, *overrides), scene, sizes)
            gc.collect()
    summary = summarize(points)
    print_table(summary, config, scene.name, sizes)
    return Outcome(
        [write_points(folder / "overhead.csv", points), *draw(summary, folder / "overhead")]
    )


def choose(only: Sequence[str]) -> list[Variant]:
    """All variants, or those that are named. Raises NerfregError for names that are none."""
    plugins = installed()
    names = [plugin.name for plugin in plugins if plugin.cls is not None]
    presets = [
        name
        for name in options("reg", plugins)
        if name not in {*(p.name for p in plugins), VANILLA}
    ]
    variants = [
        Variant(NO_MANAGER, CORE),
        *(Variant(name, PLUGIN, (f"+reg={name}",)) for name in names),
        *(Variant(name, PRESET, (f"+reg={name}",)) for name in presets),
    ]
    known = [variant.name for variant in variants]
    for name in only:
        if name not in known:
            raise NerfregError(
                f"--only {name}: no installed plugin or preset; {nearest(name, known)}"
            )
    return [variant for variant in variants if not only or variant.name in only]


def measure(
    group: Sequence[Variant], overrides: Sequence[str], scene: Scene, sizes: Sizes
) -> Iterator[Point]:
    """One point for each variant of the group and each share."""
    trainers = [variant.trainer(overrides, scene) for variant in (Variant(VANILLA, CORE), *group)]
    for trainer in trainers[1:]:
        start_alike(trainer, trainers[0])
    for share in sizes.shares:
        calls = [partial(step_at, trainer, share) for trainer in trainers]
        in_turns(calls, sizes.warmup if share == sizes.shares[0] else sizes.settling)
        before = [trainer.renderer.points for trainer in trainers]
        seconds = in_turns(calls, sizes.steps)
        points = [
            (t.renderer.points - b) / sizes.steps for t, b in zip(trainers, before, strict=True)
        ]
        for i, variant in enumerate(group, 1):
            yield compare(variant, share, (seconds[i], points[i]), (seconds[0], points[0]))


@torch.no_grad()
def start_alike(trainer: Trainer, other: Trainer) -> None:
    """Give a new trainer the weights of another, as far as they have the same names and shapes."""
    theirs = dict(other.field.named_parameters())
    for name, parameter in trainer.field.named_parameters():
        if name in theirs and theirs[name].shape == parameter.shape:
            parameter.copy_(theirs[name])


def compare(
    variant: Variant,
    share: float,
    own: tuple[Sequence[float], float],
    vanilla: tuple[Sequence[float], float],
) -> Point:
    """own, vanilla: seconds of each round, and points a step."""
    ratio = spread([a / b for a, b in zip(own[0], vanilla[0], strict=True)])
    return Point(
        variant=variant.name,
        kind=variant.kind,
        share=share,
        milliseconds=1e3 * median(own[0]),
        vanilla_milliseconds=1e3 * median(vanilla[0]),
        ratio=ratio.median,
        ratio_p10=ratio.p10,
        ratio_p90=ratio.p90,
        rounds=len(own[0]),
        points=own[1],
        vanilla_points=vanilla[1],
    )
