"""`nerfreg bench overhead`: the time of a step with each regularizer and preset, against vanilla.

Every variant is a short run of its own, from the same weights and the same seed. They take turns
step by step, vanilla among them, so that whatever else the machine does slows all of them down
alike, and move together from share to share of the budget, because windows and masks follow it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import mean, median

import torch
from rich.table import Table

from nerfreg.analysis.figures import GUIDE, PALETTE, panels, save
from nerfreg.analysis.statistics import spread
from nerfreg.analysis.tables import build_table, numbers, publish_points, select, text
from nerfreg.bench import BenchOutcome, configured
from nerfreg.bench.configured import TINY, TimedSteps, TrainingSizes
from nerfreg.config.compose import compose
from nerfreg.config.schema import Config
from nerfreg.config.search_path import options
from nerfreg.errors import NerfregError, nearest
from nerfreg.field.layers import Linear
from nerfreg.field.workers import threads
from nerfreg.hooks import Needs
from nerfreg.registry import Hooks, installed
from nerfreg.scenes.scene import Scene
from nerfreg.training.trainer import Trainer

VANILLA = "vanilla"
NO_MANAGER = "no plugin manager"
CORE, PLUGIN, PRESET = "core", "plugin", "preset"
COLORS = {CORE: PALETTE[2], PLUGIN: PALETTE[0], PRESET: PALETTE[4]}
LIMITS: dict[str, tuple[float, float]] = {
    NO_MANAGER: (0.98, 1.02),
    "combinerf": (0.0, 1.15),
    "lipschitz": (0.0, 1.05),
    "encoding_mask": (0.0, 0.85),
    "annealing": (0.0, 1.0),
    "adversarial": (0.0, 2.3),
    **dict.fromkeys(("distortion", "full_geometry", "depth_smoothness", "entropy"), (0.0, 1.03)),
}
"""The least and the most that a variant's ratio to vanilla may be; the others have no limit."""
SETTLING, TOGETHER = 5, 4
"""Steps that are not timed after moving to another share; variants in memory beside vanilla."""


@dataclass(frozen=True, kw_only=True)
class OverheadSizes(TrainingSizes):
    """Shares of the budget at which steps are timed, ascending, and names of variants or none."""

    shares: tuple[float, ...]
    only: tuple[str, ...] = ()


FULL = OverheadSizes(shares=(0.05, 0.25, 0.5, 0.75, 0.95), steps=20, warmup=60)
QUICK = OverheadSizes(shares=(0.05, 0.5), steps=2, warmup=1, defaults=TINY)


@dataclass(frozen=True)
class Variant:
    """The core, or a plugin or preset, which its name selects."""

    name: str
    kind: str

    def trainer(self, overrides: Sequence[str], scene: Scene) -> Trainer:
        """Return a trainer of the variant on a scene that is loaded already."""
        choice = [] if self.kind == CORE else [f"+reg={self.name}"]
        config = compose((*overrides, f"scene.layout={scene.layout}", *choice))
        hooks = Hooks(config.reg)
        if self.name == NO_MANAGER:
            # The core as it would be if there were no plugins to look for.
            vars(hooks).update(
                needs=lambda step: Needs(),
                layer=lambda network, index, *sizes: Linear(*sizes),
                ray_bounds=lambda rays, step: (rays.near, rays.far),
                encoder_input=lambda samples, step: samples,
                losses=lambda rendering, step: [],
            )
        return configured.make_trainer(config, scene, hooks)


@dataclass(frozen=True)
class OverheadPoint:
    """One variant at one share of the budget.

    The ratio is the median over all rounds of the variant's time to that of vanilla in the same
    round. Points are evaluations of the density a step.
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


def run(folder: Path, sizes: OverheadSizes, overrides: tuple[str, ...]) -> BenchOutcome:
    """Measure all variants, or those of `sizes.only`, and publish the points.

    Raises:
        NerfregError: The overrides choose plugins, or `sizes.only` names none.
    """
    if chosen := next((word for word in overrides if word.lstrip("+~").startswith("reg=")), None):
        raise NerfregError(
            f"{chosen}: bench overhead selects plugins itself; "
            "write --only NAME,NAME for some of them"
        )
    variants, overrides = choose(sizes.only), (*sizes.defaults, *overrides)
    config, scene = configured.set_up(overrides)
    groups = [variants[i : i + TOGETHER] for i in range(0, len(variants), TOGETHER)]
    points = [
        point
        for group in configured.announced(groups, lambda group: ", ".join(v.name for v in group))
        for point in measure(group, overrides, scene, sizes)
    ]
    table = tabulate(points, config, scene.name, sizes)
    return BenchOutcome(publish_points(folder / "overhead", points, table, draw))


def choose(only: Sequence[str]) -> list[Variant]:
    """Return all variants, or those that are named.

    Raises:
        NerfregError: A name is that of no variant.
    """
    plugins = installed()
    kinds = {NO_MANAGER: CORE} | {p.address: PLUGIN for p in plugins if p.cls is not None}
    taken = {VANILLA, *(plugin.address for plugin in plugins)}
    kinds |= {name: PRESET for name in options("reg", plugins) if name not in taken}
    for name in only:
        if name not in kinds:
            raise NerfregError(
                f"--only {name}: no installed plugin or preset; {nearest(name, kinds)}"
            )
    return [Variant(name, kind) for name, kind in kinds.items() if not only or name in only]


def measure(
    group: Sequence[Variant], overrides: Sequence[str], scene: Scene, sizes: OverheadSizes
) -> Iterator[OverheadPoint]:
    """Yield one point for each variant of the group and each share."""
    trainers = [variant.trainer(overrides, scene) for variant in (Variant(VANILLA, CORE), *group)]
    for trainer in trainers[1:]:
        start_alike(trainer, trainers[0])
    for share in sizes.shares:
        warmup = sizes.warmup if share == sizes.shares[0] else SETTLING
        vanilla, *timed = configured.time_steps(trainers, share, warmup, sizes.steps)
        for variant, own in zip(group, timed, strict=True):
            yield compare(variant, share, own, vanilla)


@torch.no_grad()
def start_alike(trainer: Trainer, other: Trainer) -> None:
    """Give a new trainer the weights of another, as far as they have the same names and shapes."""
    theirs = dict(other.field.named_parameters())
    for name, parameter in trainer.field.named_parameters():
        if name in theirs and theirs[name].shape == parameter.shape:
            parameter.copy_(theirs[name])


def compare(variant: Variant, share: float, own: TimedSteps, vanilla: TimedSteps) -> OverheadPoint:
    """Return the point of a variant's steps and those of vanilla in the same rounds."""
    ratio = spread([a / b for a, b in zip(own.seconds, vanilla.seconds, strict=True)])
    return OverheadPoint(
        *(variant.name, variant.kind, share),
        *(1e3 * median(own.seconds), 1e3 * median(vanilla.seconds)),
        *(ratio.median, ratio.p10, ratio.p90),
        rounds=len(own.seconds),
        points=own.points,
        vanilla_points=vanilla.points,
    )


def summarize(points: Sequence[OverheadPoint]) -> list[OverheadPoint]:
    """Return one point for each variant, whose ratios are means over all shares."""
    summary = []
    for variant in dict.fromkeys(point.variant for point in points):
        own = select(points, variant=variant)
        ratios = ("ratio", "ratio_p10", "ratio_p90", "points", "vanilla_points")
        means = {name: mean(getattr(point, name) for point in own) for name in ratios}
        summary.append(replace(own[0], **means))
    return summary


def tabulate(
    points: Sequence[OverheadPoint], config: Config, scene: str, sizes: OverheadSizes
) -> Table:
    """Return ratio, spread, points and limit of every variant."""
    rows = []
    for line in summarize(points):
        evaluations, (limit, missed) = line.points / line.vanilla_points, verdict(line)
        span = f"{line.ratio_p10:.2f}-{line.ratio_p90:.2f}"
        rows.append((line.variant, f"{line.ratio:.3f}", span, f"{evaluations:.2f}", limit, missed))
    shares = ", ".join(f"{100 * share:g}" for share in sizes.shares)
    return build_table(
        f"Time of a training step against vanilla: {scene}, {config.train.rays} rays x "
        f"({config.sampler.coarse} + {config.sampler.fine}) samples",
        f"Median over {sizes.steps} alternating steps of the ratio to vanilla's step in the same "
        f"round, and its 10 and 90 % quantiles, averaged over {shares} % of the budget. points: "
        f"density evaluations, against vanilla's. Threads: {threads()}.",
        [*text("variant"), *numbers("ratio", "10-90 %", "points", "limit", "")],
        rows,
    )


def verdict(line: OverheadPoint) -> tuple[str, str]:
    """Return the limit of a variant, which has two digits, and whether it is missed in these."""
    if line.variant not in LIMITS:
        return "", ""
    least, most = LIMITS[line.variant]
    limit = f"{least:.2f}-{most:.2f}" if least else f"{most:.2f}"
    return limit, "" if least <= round(line.ratio, 2) <= most else "missed"


def draw(points: Sequence[OverheadPoint], stem: Path) -> list[Path]:
    """Draw a bar for each variant, its spread as a line and its limits as marks."""
    summary = summarize(points)
    names, longest = [line.variant for line in summary], max(line.ratio_p90 for line in summary)
    with panels(1, 1, 8.0, 1.6 + 0.3 * len(summary)) as (figure, [[panel]]):
        panel.set(xscale="linear", yscale="linear")
        for row, line in enumerate(summary):
            panel.barh(row, line.ratio, height=0.62, color=COLORS[line.kind], alpha=0.85)
            panel.plot((line.ratio_p10, line.ratio_p90), (row, row), color="black", linewidth=1.2)
            ends = [end for end in LIMITS.get(line.variant, ()) if end]
            panel.vlines(ends, row - 0.42, row + 0.42, color=PALETTE[1], linewidth=2.2, zorder=3)
        panel.axvline(1, color=GUIDE, linestyle="--")
        panel.set_yticks(range(len(summary)), names)
        panel.set(ylim=(len(summary) - 0.4, -0.6), xlim=(0, 1.05 * max(1.1, longest)))
        panel.set_xlabel("time of a step, vanilla = 1 (line: 10 to 90 %; red: limit)")
        figure.suptitle("Time of a step with each regularizer and each preset", fontsize=11.5)
        return save(figure, stem)
