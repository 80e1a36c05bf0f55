"""`nerfreg bench losses`: error and run time of every plugin's loss, beside other forms of it.

A plugin takes part if it makes terms of a rendering alone and ships their exact values
(`nerfreg_reference`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, product
from pathlib import Path
from statistics import median

import torch
from jaxtyping import Float
from rich.table import Table
from torch import Tensor

from nerfreg.analysis.curves import Dot, draw_curves
from nerfreg.analysis.tables import build_table, numbers, publish_points, select, text
from nerfreg.bench import BenchOutcome
from nerfreg.bench.inputs import INPUTS, PATCH, LossInput
from nerfreg.bench.rivals import MOST_SAMPLES, RIVALS
from nerfreg.bench.timing import RaySizes, median_seconds
from nerfreg.errors import NerfregError, NoRendererError
from nerfreg.hooks import Rendering, Step
from nerfreg.registry import Hooks, PluginInfo, installed

PLUGIN = "plugin"
"""The form of a loss that is the plugin's own."""
DIFFERENTIABLE = ("density", "tau", "log_transmittance", "weights", "opacity", "depth", "rgb")
SMALLEST = torch.finfo(torch.float32).tiny
SPAN = (1e-9, 1e3)
"""Errors beyond are drawn there."""


FULL = RaySizes(tuple(2**k for k in range(3, 12)), rays=256, repetitions=7)
QUICK = RaySizes((8, 32), rays=32, repetitions=2)


@dataclass(frozen=True)
class LossPoint:
    """One loss in one form on one input.

    Value and exact are the sum of its terms on `exact_rays` rays in float32, and what it should be;
    for the relative error, an exact value below the smallest normal float32 counts as that.
    Milliseconds are those of forward and backward on `rays` rays.
    """

    plugin: str
    form: str
    input: str
    samples: int
    relative_error: float
    milliseconds: float
    value: float
    exact: float
    exact_rays: int
    rays: int


def run(folder: Path, sizes: RaySizes) -> BenchOutcome:
    """Measure all losses on all inputs and sizes, and publish the points.

    Raises:
        NerfregError: No plugin can take part.
    """
    losses = [info for info in installed() if "loss" in info.hook_points]
    measured = {info.address: measure(info, sizes) for info in losses}
    points = list(chain(*measured.values()))
    if not points:
        raise NerfregError(
            "bench losses: no installed plugin ships exact values of its loss; "
            "see `nerfreg plugins`"
        )
    table = tabulate(points, [name for name, own in measured.items() if not own], sizes)
    return BenchOutcome(publish_points(folder / "losses", points, table, draw))


def measure(info: PluginInfo, sizes: RaySizes) -> list[LossPoint]:
    """Return one point for each form, input and number of samples; none if it cannot take part."""
    if info.cls is None or "loss" not in info.hook_points:
        return []
    hooks = Hooks({info.name: info.cls(weight=1.0, start=0.0)})
    cases = product(INPUTS, sizes.samples)
    measured = [_measure(info.name, hooks, given, samples, sizes) for given, samples in cases]
    return list(chain(*measured)) if all(measured) else []


def _measure(
    name: str, hooks: Hooks, given: LossInput, samples: int, sizes: RaySizes
) -> list[LossPoint]:
    step = Step(50, 100, 0.5, torch.Generator().manual_seed(0), (given.near, given.far))
    # Exact values take long; rays come in patches.
    exact_rays = max(sizes.rays // 8, PATCH**2)
    few, many = given.rendering(exact_rays, samples), given.rendering(sizes.rays, samples)

    def own(rendering: Rendering) -> Float[Tensor, ""]:
        return torch.stack([term.value for term in hooks.losses(rendering, step)]).sum()

    try:
        exact = hooks.reference(name, few, step)
        if not exact or not hooks.losses(few, step):
            return []
    except NoRendererError:
        return []
    rivals = RIVALS.get(name, {}).items()
    forms = {f: loss for f, loss in rivals if samples <= MOST_SAMPLES.get(f, samples)}
    forms = {PLUGIN: own, **forms}
    calls = [partial(forward_and_backward, loss, many) for loss in forms.values()]
    truth, points = float(sum(exact.values())), []
    for form, seconds in zip(forms, median_seconds(calls, sizes.repetitions), strict=True):
        value = float(forms[form](few))
        error = abs(value - truth) / max(abs(truth), SMALLEST)
        result = (error, 1e3 * seconds, value, truth, exact_rays, sizes.rays)
        points.append(LossPoint(name, form, given.name, samples, *result))
    return points


def forward_and_backward(
    loss: Callable[[Rendering], Float[Tensor, ""]], rendering: Rendering
) -> tuple[Float[Tensor, ""], dict[str, Tensor | None]]:
    """Return the loss and its gradients by what compositing made; None for what it does not use."""
    leaves = {name: getattr(rendering, name).detach().requires_grad_() for name in DIFFERENTIABLE}
    value = loss(replace(rendering, **leaves))
    gradients = torch.autograd.grad(value, list(leaves.values()), allow_unused=True)
    return value.detach(), dict(zip(leaves, gradients, strict=True))


def tabulate(points: Sequence[LossPoint], left_out: Sequence[str], sizes: RaySizes) -> Table:
    """Return for each form its worst error on each input and its time at the most samples."""
    caption = (
        f"Worst relative error in float32 over {sizes.samples[0]} to {sizes.samples[-1]} samples, "
        f"on {points[0].exact_rays} rays. Times: forward and backward on {sizes.rays} rays at the "
        f"most samples that the form was run with; {sizes.conditions}."
    )
    if left_out:
        caption += " Without a term of a rendering alone, or without exact values: "
        caption += f"{', '.join(left_out)}."
    names = [given.name for given in INPUTS]
    rows = []
    for plugin, form in dict.fromkeys((point.plugin, point.form) for point in points):
        own = select(points, plugin=plugin, form=form)
        worst = [max(p.relative_error for p in select(own, input=name)) for name in names]
        most = max(point.samples for point in own)
        # The inputs make no difference to the time.
        time = median(point.milliseconds for point in select(own, samples=most))
        rows.append((plugin, form, *(f"{error:.0e}" for error in worst), f"{most}", f"{time:.3g}"))
    columns = [*text("plugin", "form"), *numbers(*names, "samples", "ms")]
    return build_table("Losses: error by input, and run time", caption, columns, rows)


def draw(points: Sequence[LossPoint], stem: Path) -> list[Path]:
    """Draw errors, a row for each input, and times against samples, a column for each plugin."""
    # Those with a form to compare with come first: they are what the figure is about.
    points = sorted(points, key=lambda point: point.plugin not in RIVALS)
    dots = [Dot(f"{p.input} error", p.plugin, p.form, p.samples, p.relative_error) for p in points]
    dots += [Dot("time (ms)", p.plugin, p.form, p.samples, p.milliseconds) for p in points]
    title = f"Losses in float32: relative error, and run time of {points[0].rays} rays"
    width = 2.25 * len({point.plugin for point in points})
    return draw_curves(stem, dots, title, (max(width, 7.5), 11.0), "samples per ray", SPAN)
