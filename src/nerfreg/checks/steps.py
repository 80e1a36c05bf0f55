"""Checks over the steps of a run: the plugin is driven from the first step to the last."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from nerfreg.checks.cases import CASES
from nerfreg.checks.driver import STEPS, Driver
from nerfreg.checks.inputs import Inputs, cast
from nerfreg.checks.report import Report, Spot, in_words
from nerfreg.checks.subject import Subject
from nerfreg.checks.watch import DUE, FOUND_OUT, WatchedHooks, core_weights
from nerfreg.hooks import Rendering, Step
from nerfreg.registry import Term

SAMPLES = 16
FIRST = 21
"""Steps 0 to 20 of a run of 20: the last one is where the budget is spent."""

WINDOWS: tuple[tuple[int | float, int | float], ...] = ((0.25, 0.75), (5, 12), (3, 1.0))
SETTLED = 5
"""Number of steps after which a plugin has what it keeps."""


@dataclass(frozen=True)
class RunCase:
    """What is checked over a run and not over rays: it takes no precision and no samples."""

    name: str
    description: str

    def points(self, dtypes: Sequence[str], samples: int | None) -> Iterator[tuple[Spot, None]]:
        """Yield one spot, in float32."""
        if "float32" in dtypes:
            yield Spot(self.name, "float32"), None


STEPS_CASE = RunCase("steps", "steps 0 to 20, and those around the corners of windows")


def small_inputs(samples: int = SAMPLES, case: int = 0) -> Inputs:
    """Return fog in float32."""
    return cast(CASES[case].build(samples), torch.float32)


def check_steps(report: Report, case: RunCase, _: None) -> None:
    """Check that no step raises, that nothing is changed besides, and that nothing is kept."""
    own = report.subject.configured()
    window = own.start, own.end
    found: dict[str, list[str]] = {"steps": [], "contract": [], "effects": []}
    _drive(report.subject, (0.0, 1.0), range(FIRST), FIRST - 1, found)
    for corners in dict.fromkeys((window, *WINDOWS)):
        total = STEPS if corners == window else FIRST - 1
        _drive(report.subject, corners, around(corners, total), total, found)
    for check, lines in found.items():
        # A fault of many steps is one fault.
        report.judge(check, dict.fromkeys(lines))


def around(window: tuple[int | float, int | float], total: int) -> list[int]:
    """Return the first and last steps of a run, and those around the corners of a window."""
    ends = [corner if isinstance(corner, int) else round(corner * total) for corner in window]
    found = {0, 1, total - 1, total, *(end + by for end in ends for by in (-1, 0, 1))}
    return sorted(index for index in found if 0 <= index <= total)


def _drive(
    subject: Subject,
    window: tuple[int | float, int | float],
    steps: Sequence[int],
    total: int,
    found: Mapping[str, list[str]],
) -> None:
    """Make steps with the plugin's window set, and add what is found to the lines of each check."""
    hooks = WatchedHooks(subject.selected(*window))
    driver = Driver(subject, small_inputs(), hooks)
    hooks.weights = core_weights([("grid", driver.table), *driver.networks.items()])
    kept = Kept()
    for index in steps:
        try:
            kept.add(play(driver, driver.step_at(index, total)))
        except Exception as error:  # a foreign plugin may raise anything
            found["steps"].append(f"{in_words(error)}, at step {index} of {total}")
            break
        if index == SETTLED and len(steps) == FIRST:
            kept.settle()
    try:
        hooks.end(driver.step_at(steps[-1], total))
    except Exception as error:  # a foreign plugin may raise anything
        found["steps"].append(f"{in_words(error)}, at the end of a run")
    if len(steps) == FIRST:
        # The plugin was on in every step.
        found["steps"] += kept.faults()
        found["contract"] += hooks.fallen_silent([hook for hook in DUE if hook not in FOUND_OUT])
    for check in ("contract", "effects"):
        found[check].extend(hooks.take(check))


def play(driver: Driver, step: Step) -> Rendering:
    """Make one step of training with the case: all hooks in their order, backward, and an update.

    Returns:
        The rendering of the step, through all hooks.
    """
    hooks, rays = driver.hooks, driver.inputs.rays
    hooks.begin(step)
    hooks.needs(step)
    hooks.unseen_poses(step, driver.scene, 4)
    rays = hooks.rays(rays, step)
    hooks.ray_bounds(rays, step)
    rendering = driver.render(rays, step, driver.rendering)
    update(driver, rendering, hooks.losses(rendering, step))
    hooks.step_end(step)
    return rendering


def update(driver: Driver, rendering: Rendering, terms: Sequence[Term]) -> None:
    """Differentiate the colour error and all terms, and make a step of plain descent."""
    error = (rendering.rgb[: len(rendering.rays.targets)] - rendering.rays.targets).square().mean()
    total = error + sum(term.weight * term.value for term in terms)
    leaves = [leaf for _, leaf in driver.leaves]
    for leaf in leaves:
        leaf.grad = None
    total.backward()
    with torch.no_grad():
        # Density and colours are the case, which stays as it is.
        for leaf in leaves[2:]:
            if leaf.grad is not None and bool(leaf.grad.isfinite().all()):
                leaf -= 1e-3 * leaf.grad / leaf.grad.norm().clamp_min(1.0)
            leaf.grad = None
    driver.density.grad = driver.colors.grad = None


class Kept:
    """Finds out whether what belongs to a step outlives it."""

    def __init__(self) -> None:
        self._renderings: list[weakref.ref[Rendering]] = []
        self._tensors: dict[str, list[weakref.ref[Tensor]]] = {}
        self._settled = (0, 0)

    def add(self, rendering: Rendering) -> None:
        """Take note of a rendering, which nobody should need any more."""
        self._renderings.append(weakref.ref(rendering))
        for name in ("density", "weights", "depth", "rgb"):
            self._tensors.setdefault(name, []).append(weakref.ref(getattr(rendering, name)))

    def settle(self) -> None:
        """Take note of the memory that is in use now."""
        self._settled = len(self._renderings), _bytes_in_use()

    def faults(self) -> list[str]:
        """Return what is kept, and how fast memory has grown since `settle`."""
        steps = len(self._renderings) - self._settled[0]
        grown = _bytes_in_use() - self._settled[1] if self._settled[0] else 0
        growth = grown / max(steps, 1)
        whole = sum(made() is not None for made in self._renderings)
        parts = [name for name, made in self._tensors.items() if any(x() is not None for x in made)]
        instead = "keep detached numbers in its place, such as float(term)"
        if whole:
            count = f"the renderings of {whole} of {len(self._renderings)} steps"
            return [f"{count} are kept alive after their step: memory grows; {instead}"]
        if parts:
            some = ", ".join(f"rendering.{name}" for name in parts)
            return [f"{some} and its graph are kept alive after the step; {instead}"]
        # A number for each ray and step may be a history that somebody wants to see; more is not.
        if growth > 4 * len(CASES[0].build(1).rays):
            return [f"memory grows by {growth / 1000:.1f} kB in each step; {instead}"]
        return []


def _bytes_in_use() -> int:
    gc.collect()
    # By type, because the attributes of some objects are made when they are looked at.
    tensors = [found for found in gc.get_objects() if issubclass(type(found), Tensor)]
    storages = {x.untyped_storage().data_ptr(): x.untyped_storage().nbytes() for x in tensors}
    return sum(storages.values())
