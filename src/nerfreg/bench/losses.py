"""`nerfreg bench losses`: error and run time of every installed plugin's loss, beside the forms in use elsewhere.

A plugin takes part if it makes terms of a rendering alone and ships their exact values (`nerfreg_reference`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.analysis.tables import Outcome, write_points
from nerfreg.bench.inputs import INPUTS, Input
from nerfreg.bench.rivals import RIVALS
from nerfreg.bench.timing import median_seconds
from nerfreg.errors import NerfregError, NoRendererError
from nerfreg.hooks import Rendering, Step
from nerfreg.registry import Hooks, PluginInfo, installed

PLUGIN = "plugin"
"""The form of a loss that is the plugin's own."""
DIFFERENTIABLE = ("density", "tau", "log_transmittance", "weights", "opacity", "depth", "rgb")
SMALLEST = torch.finfo(torch.float32).tiny


@dataclass(frozen=True)
class Sizes:
    """samples: per ray, ascending. rays: in each measurement of time. exact_rays: in each comparison with exact
    values, which take long. repetitions: of each measurement of time."""

    samples: tuple[int, ...]
    rays: int
    exact_rays: int
    repetitions: int


FULL = Sizes(tuple(2**k for k in range(3, 12)), rays=256, exact_rays=32, repetitions=7)
QUICK = Sizes((8, 32), rays=32, exact_rays=16, repetitions=2)


@dataclass(frozen=True)
class Point:
    """One loss in one form on one input.

    value, exact: the sum of its terms on `exact_rays` rays in float32, and what it should be. relative_error: between
    the two, where an exact value below the smallest normal float32 counts as that. milliseconds: forward and backward
    on `rays` rays.
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


def run(folder: Path, sizes: Sizes) -> Outcome:
    """Measure all losses on all inputs and sizes; print a table; write a CSV file and a plot."""
    from nerfreg.bench.losses_report import draw, print_table

    points: list[Point] = []
    left_out: list[str] = []
    for info in installed():
        measured = measure(info, sizes)
        points += measured
        if not measured and info.cls is not None and "loss" in info.hook_points:
            left_out.append(info.name)
    if not points:
        raise NerfregError(
            "bench losses: no installed plugin ships exact values of its loss; see `nerfreg plugins`"
        )
    print_table(points, left_out, sizes)
    return Outcome(
        [write_points(folder / "losses.csv", points), *draw(points, sizes, folder / "losses")]
    )


def measure(info: PluginInfo, sizes: Sizes) -> list[Point]:
    """One point for each form, input and number of samples; none if the plugin cannot take part."""
    if info.cls is None or "loss" not in info.hook_points:
        return []
    hooks = Hooks({info.name: info.cls(weight=1.0, start=0.0)})
    points = []
    for given, samples in product(INPUTS, sizes.samples):
        measured = _measure(info.name, hooks, given, samples, sizes)
        if not measured:
            return []
        points += measured
    return points


def _measure(name: str, hooks: Hooks, given: Input, samples: int, sizes: Sizes) -> list[Point]:
    step = Step(50, 100, 0.5, torch.Generator().manual_seed(0), (given.near, given.far))
    few, many = given.rendering(sizes.exact_rays, samples), given.rendering(sizes.rays, samples)

    def own(rendering: Rendering) -> Float[Tensor, ""]:
        return torch.stack([term.value for term in hooks.losses(rendering, step)]).sum()

    try:
        exact = hooks.reference(name, few, step)
        if not exact or not hooks.losses(few, step):
            return []
    except NoRendererError:
        return []
    rivals = [rival for rival in RIVALS.get(name, ()) if samples <= (rival.most_samples or samples)]
    forms = {PLUGIN: own} | {rival.name: rival.loss for rival in rivals}
    seconds = median_seconds(
        [partial(forward_and_backward, loss, many) for loss in forms.values()], sizes.repetitions
    )
    truth = float(sum(exact.values()))
    points = []
    for (form, loss), time in zip(forms.items(), seconds, strict=True):
        value = float(loss(few))
        error = abs(value - truth) / max(abs(truth), SMALLEST)
        points.append(
            Point(
                plugin=name,
                form=form,
                input=given.name,
                samples=samples,
                relative_error=error,
                milliseconds=time * 1e3,
                value=value,
                exact=truth,
                exact_rays=sizes.exact_rays,
                rays=sizes.rays,
            )
        )
    return points


def forward_and_backward(
    loss: Callable[[Rendering], Float[Tensor, ""]], rendering: Rendering
) -> tuple[Float[Tensor, ""], dict[str, Tensor | None]]:
    """The loss, and its gradients with respect to what compositing made, by name; None for what it does not use."""
    leaves = {name: getattr(rendering, name).detach().requires_grad_() for name in DIFFERENTIABLE}
    value = loss(replace(rendering, **leaves))
    gradients = torch.autograd.grad(value, list(leaves.values()), allow_unused=True)
    return value.detach(), dict(zip(leaves, gradients, strict=True))
