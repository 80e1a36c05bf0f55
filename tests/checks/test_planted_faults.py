"""Plugins whose results are right and which do harm all the same; each fault is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
import torch
from torch import nn

from nerfreg import Needs, Regularizer, hookimpl
from nerfreg.checks import watch
from nerfreg.checks.report import Report
from nerfreg.checks.run import ALL_CASES
from nerfreg.checks.run import check_plugin as check
from nerfreg.hooks import OccupancyGrid, TrainedModule

Found = dict[str, list[str]]


@pytest.fixture
def found(subject) -> Callable[..., Found]:
    """The messages of the failures in the named cases, by check, in float32 with 48 samples."""

    def found(cls: type[Regularizer], *names: str) -> Found:
        cases = [case for case in ALL_CASES if case.name in names]
        report: Report = check(subject(cls), cases, ("float32",), 48)
        messages: Found = {}
        for failure in report.failures:
            messages.setdefault(failure.check, []).append(failure.message)
        return messages

    return found


@dataclass
class Clean(Regularizer):
    """Mean opacity, with everything that a plugin may do besides, done right."""

    def __post_init__(self):
        self._steps = 0
        self._mean = torch.zeros(())

    @hookimpl
    def nerfreg_module(self):
        self._gain = nn.Linear(1, 1)
        return self._gain

    @hookimpl
    def nerfreg_needs(self):
        return Needs(unseen_rays=0.25)

    @hookimpl
    def nerfreg_prepare(self, photographs):
        return {"gray": photographs.images[..., :3].mean(-1)}

    @hookimpl(wrapper=True)
    def nerfreg_density(self, samples, step):
        density = yield
        kept = torch.rand(density.shape, generator=step.generator) > 0.1
        return density * kept

    @hookimpl
    def nerfreg_loss(self, rendering, step):
        gray = rendering.rays.data["suspect.gray"]
        error = (rendering.opacity[: len(gray)] - gray).square().mean()
        return {"opacity": error + self._mean, "gain": self._gain.weight.square().sum()}

    @hookimpl
    def nerfreg_step_end(self):
        self._steps += 1
        self._mean = self._mean + 0.01

    @hookimpl
    def nerfreg_metrics(self):
        return {"steps": self._steps}

    def state_dict(self):
        return {"steps": self._steps, "mean": self._mean}

    def load_state_dict(self, state):
        self._steps, self._mean = state["steps"], state["mean"]


def test_clean_plugin_passes(found):
    assert found(Clean, "fog", "photos_noise", "terms", "steps", "cost", "run") == {}


@dataclass
class Double(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": rendering.opacity.double().square().mean()}


@dataclass
class Half(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": rendering.opacity.bfloat16().square().mean()}


def test_precision(found):
    assert found(Double, "fog")["value"] == [
        "term 'suspect' is in float64, the rendering in float32: "
        "it doubles the cost of all that follows; return float32"
    ]
    assert found(Half, "fog")["value"] == [
        "term 'suspect' is in bfloat16, the rendering in float32: "
        "it has too few digits for a loss; return float32"
    ]


@dataclass
class Detached(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"item": torch.tensor(rendering.opacity.square().mean().item())}


@dataclass
class Flat(Regularizer):
    """A count has no slope, although it is part of the graph; nor has a constant."""

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {
            "count": (rendering.weights.round(decimals=3) + 0 * rendering.weights).mean(),
            "constant": torch.tensor(1.0),
            "some": rendering.opacity.clamp_min(0.5).mean(),
        }


def test_no_gradient(found):
    assert found(Detached, "terms")["gradient"] == [
        "term 'item' has no gradient by anything, although it changes with density and colour: "
        "is it detached, or made by numpy or .item()?"
    ]
    count, constant = found(Flat, "terms")["gradient"]
    assert count == (
        "term 'count' has a gradient of 0 everywhere, although it changes with density and colour: "
        "it trains nothing"
    )
    assert constant.startswith("term 'constant' has no gradient by anything, and never changes")


@dataclass
class KeepsRenderings(Regularizer):
    def __post_init__(self):
        self._renderings = []

    @hookimpl
    def nerfreg_loss(self, rendering):
        self._renderings.append(rendering)
        return {"suspect": rendering.opacity.square().mean()}


@dataclass
class KeepsGraph(Regularizer):
    """A running mean that was not detached holds the graph of every step."""

    def __post_init__(self):
        self._mean = 0.0

    @hookimpl
    def nerfreg_loss(self, rendering):
        self._weights = rendering.weights
        return {"suspect": rendering.opacity.square().mean()}


@dataclass
class KeepsCopies(Regularizer):
    def __post_init__(self):
        self._history = []

    @hookimpl
    def nerfreg_loss(self, rendering):
        self._history.append(rendering.weights.detach().clone())
        return {"suspect": rendering.opacity.square().mean()}


def test_renderings_kept_alive(found):
    [line] = found(KeepsRenderings, "steps")["steps"]
    assert line.startswith("the renderings of 21 of 21 steps are kept alive after their step")
    [line] = found(KeepsGraph, "steps")["steps"]
    assert line.startswith("rendering.weights and its graph are kept alive after the step")
    [line] = found(KeepsCopies, "steps")["steps"]
    # 20 rays with 16 samples of 4 bytes
    assert line.startswith("memory grows by 1.3 kB in each step")


@dataclass
class LateKeyError(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering, step):
        return {
            "suspect": rendering.opacity.square().mean()
            * {**dict.fromkeys(range(13), 1.0)}[step.index]
        }


@dataclass
class AtTheEndOfItsWindow(Regularizer):
    """Divides by what is left of its window, which it believes to be that of its configuration."""

    start: int | float = 0.1
    end: int | float = 0.5

    @hookimpl
    def nerfreg_loss(self, rendering, step):
        if step.total == 1000 and step.index == 499:
            raise ZeroDivisionError("nothing left")
        return {"suspect": rendering.opacity.square().mean()}


@dataclass
class NeedsTheFirstStep(Regularizer):
    """Is made ready by step 0, which a window that opens later leaves out."""

    @hookimpl
    def nerfreg_loss(self, rendering, step):
        if step.index == 0:
            self._scale = 1.0
        return {"suspect": self._scale * rendering.opacity.square().mean()}


def test_exception_at_a_later_step(found):
    assert "raises KeyError: 13, at step 13 of 20" in found(LateKeyError, "steps")["steps"]
    assert found(AtTheEndOfItsWindow, "steps")["steps"] == [
        "raises ZeroDivisionError: nothing left, at step 499 of 1000"
    ]
    lines = found(NeedsTheFirstStep, "steps")["steps"]
    assert any("AttributeError" in line and line.endswith("at step 5 of 20") for line in lines)


@dataclass
class AllPairs(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering):
        w, t = rendering.weights, rendering.t
        apart = (t[:, :, None] - t[:, None]).abs()
        return {"suspect": (w[:, :, None] * w[:, None] * apart).sum((1, 2)).mean()}


@dataclass
class TriangularMatrix(Regularizer):
    """A sum of all weights before, by a matrix product; the matrix is made once and kept."""

    @hookimpl
    def nerfreg_loss(self, rendering):
        count = rendering.weights.shape[1]
        if not hasattr(self, "_matrix") or len(self._matrix) != count:
            self._matrix = torch.ones(count, count).triu()
        return {"suspect": (rendering.weights @ self._matrix).square().mean()}


@dataclass
class PairsOfRays(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": (rendering.depth[:, None] - rendering.depth).square().mean()}


@dataclass
class NumpyPairs(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering):
        t = rendering.t.detach().double().numpy()
        spread = float(np.abs(t[:, :, None] - t[:, None]).mean())
        return {"suspect": spread * rendering.opacity.square().mean()}


@dataclass
class Sorts(Regularizer):
    """N log N is no square."""

    @hookimpl
    def nerfreg_loss(self, rendering):
        w = rendering.weights.sort(dim=1).values
        return {"suspect": (w * w.cumsum(1)).sum(1).mean()}


@pytest.mark.parametrize(
    ("cls", "line"),
    [
        (AllPairs, "cost grows with N^2: four times as many samples need"),
        (TriangularMatrix, "cost grows with N^2: four times as many samples need"),
        (NumpyPairs, "cost grows with N^2: four times as many samples need"),
        (PairsOfRays, "cost grows with R^2: four times as many rays need"),
    ],
)
def test_quadratic_cost(cls, line, found):
    # On a busy machine the other axis may seem to be quadratic, too.
    messages = found(cls, "cost")["cost"]
    assert any(message.startswith(line) for message in messages)


def test_sorting_is_not_quadratic(found):
    assert found(Sorts, "cost") == {}


@dataclass
class GlobalRandomness(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering):
        noise = torch.rand(()) + np.random.rand() + watch.random.random()
        return {"suspect": noise * rendering.opacity.square().mean()}


def test_global_randomness(found):
    assert found(GlobalRandomness, "steps")["effects"] == [
        "nerfreg_loss draws from torch's global generator, or seeds it; use step.generator",
        "nerfreg_loss draws from numpy's global generator, or seeds it; use step.generator",
        "nerfreg_loss draws from Python's module random, or seeds it; use step.generator",
    ]


@dataclass
class SeedsTheStep(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering, step):
        step.generator.manual_seed(7)
        torch.set_num_threads(torch.get_num_threads())
        return {"suspect": rendering.opacity.square().mean()}


@dataclass
class EditsTargets(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering):
        rendering.rays.targets.data.clamp_(0.1, 0.9)
        return {"suspect": rendering.opacity.square().mean()}


@dataclass
class EditsWeights(Regularizer):
    @hookimpl
    def nerfreg_step_end(self, step):
        with torch.no_grad():
            for level in step.field.tables:
                level.table.mul_(0.9)


@dataclass
class GoesBackward(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering, step):
        term = step.field.density(rendering.rays.origins.detach()).mean()
        term.backward(retain_graph=True)
        return {"suspect": term}


def test_side_effects(found):
    assert found(SeedsTheStep, "steps")["effects"] == [
        "nerfreg_loss seeds step.generator; draw from it, and leave its state alone"
    ]
    assert (
        "nerfreg_loss: rendering.rays.targets has been edited in place"
        in found(EditsTargets, "steps")["effects"]
    )
    [line] = found(EditsWeights, "steps")["effects"]
    assert line.startswith("nerfreg_step_end changes weights of the field: grid")
    [line] = found(GoesBackward, "steps")["effects"]
    assert line.startswith("nerfreg_loss adds to the gradient of the field's weights")


@dataclass
class OrderAndChunks(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering):
        return {
            "first": rendering.opacity[0] + 0,
            "root": rendering.opacity.square().mean().sqrt(),
        }


@dataclass
class Threads(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": rendering.opacity.square().mean() * torch.get_num_threads()}


def test_order_chunks_and_threads(found):
    lines = found(OrderAndChunks, "fog", "terms")["invariance"]
    assert {line.partition(":")[0] for line in lines} >= {
        "term 'first' depends on the order of the rays",
        "term 'first' depends on chunks of rays",
        "term 'root' depends on chunks of rays",
    }
    [line] = found(Threads, "terms")["invariance"]
    assert line.startswith("term 'suspect' depends on the number of threads: ")


@dataclass
class KeepsItsNetwork(Regularizer):
    """A trainable network that is neither a layer nor the plugin's module."""

    def __post_init__(self):
        self._network = nn.Linear(1, 1)

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": self._network(rendering.opacity[:, None]).square().mean()}


@dataclass
class ForgetsItsCount(Regularizer):
    """The weight of the term grows with a count that no checkpoint holds."""

    def __post_init__(self):
        self._count = 0

    @hookimpl
    def nerfreg_loss(self, rendering):
        self._count += 1
        return {"suspect": self._count * rendering.opacity.square().mean()}


@dataclass
class SavesAndForgets(ForgetsItsCount):
    def state_dict(self):
        return {"count": self._count}


@dataclass
class UnsaveableState(ForgetsItsCount):
    def state_dict(self):
        return {"count": {self._count}}


class Remembering(nn.Module):
    """A mean that is an attribute and no buffer."""

    def __init__(self):
        super().__init__()
        self.gain = nn.Parameter(torch.ones(()))
        self.mean = torch.zeros(())


@dataclass
class ModuleWithoutBuffers(Regularizer):
    @hookimpl
    def nerfreg_module(self):
        self._module = Remembering()
        return self._module

    @hookimpl
    def nerfreg_loss(self, rendering):
        mean = 0.9 * self._module.mean + 0.1 * rendering.opacity.detach().mean()
        self._module.mean = mean
        return {"suspect": (self._module.gain * rendering.opacity - mean).square().mean()}


def test_state_that_is_not_saved_or_restored(found):
    assert found(KeepsItsNetwork, "run")["state"] == [
        "self._network: 2 parameters that are neither trained nor saved; "
        "return the module from nerfreg_module"
    ]
    for cls in (ForgetsItsCount, SavesAndForgets, ModuleWithoutBuffers):
        [line] = found(cls, "run")["state"]
        assert line.startswith("term 'suspect' of the next step is"), cls
        assert "with everything restored from the checkpoint" in line
    [line] = found(UnsaveableState, "run")["state"]
    assert line.startswith("state_dict()['count']: is of type set; a checkpoint holds tensors")


@dataclass
class LastMaskInEvaluation(Regularizer):
    """Sample dropout by a layer whose last mask stays in force."""

    in_evaluation: ClassVar[tuple[str, ...]] = ("nerfreg_density",)

    def __post_init__(self):
        self._factor = 1.0

    @hookimpl
    def nerfreg_loss(self, step):
        self._factor = float(torch.rand((), generator=step.generator))
        return {}

    @hookimpl(wrapper=True)
    def nerfreg_density(self):
        density = yield
        return density * self._factor


def test_evaluation_leak(found):
    lines = found(LastMaskInEvaluation, "run")["run"]
    [line] = lines
    assert line.startswith("evaluation leak: evaluation right after training differs by")


@dataclass
class NothingReturned(Regularizer):
    @hookimpl
    def nerfreg_rays(self, rays):
        replace(rays, near=rays.near * 1.1)

    @hookimpl
    def nerfreg_loss(self, rendering):
        {"suspect": rendering.opacity.square().mean()}


@dataclass
class WrapperReturnsNothing(Regularizer):
    @hookimpl(wrapper=True)
    def nerfreg_density(self):
        density = yield
        density * 2


def test_none_where_a_value_is_due(found):
    messages = found(NothingReturned, "steps")
    assert messages["contract"] == [
        "nerfreg_rays returned None each time, which has no effect; return rays"
    ]
    assert any("nerfreg_loss at step 0: returned None" in line for line in messages["steps"])
    lines = found(WrapperReturnsNothing, "fog")["contract"]
    assert any("nerfreg_density" in line and "returned None" in line for line in lines)


@dataclass
class WrongAnswers(Regularizer):
    """One mistake in each of the hooks around the rendering."""

    @property
    def color_inputs(self):
        return 2

    @hookimpl(wrapper=True)
    def nerfreg_rays(self):
        rays = yield
        return replace(rays, directions=2 * rays.directions)

    @hookimpl
    def nerfreg_unseen_poses(self, count):
        return torch.full((count, 3, 4), 0.5)

    @hookimpl(wrapper=True)
    def nerfreg_density(self):
        density = yield
        return density - 100.0

    @hookimpl
    def nerfreg_color_input(self, samples):
        return torch.zeros(len(samples.ray), 2, dtype=torch.float64)

    @hookimpl(wrapper=True)
    def nerfreg_rendering(self):
        rendering = yield
        return replace(rendering, rgb=rendering.rgb.double())


def test_wrong_answers_are_all_named(found):
    lines = "\n".join(found(WrongAnswers, "steps")["contract"])
    for line in (
        "nerfreg_rays: directions: not of unit length, off by up to 1",
        "nerfreg_unseen_poses: poses: 4 of 4 are no rotations",
        "nerfreg_density: density: negative at",
        "nerfreg_color_input: features: has dtype torch.float64, not torch.float32",
        "nerfreg_rendering: rgb: has dtype torch.float64, not torch.float32",
    ):
        assert line in lines


@dataclass
class NotTruthValues(Regularizer):
    @hookimpl
    def nerfreg_empty(self, positions):
        return positions[:, 0]


@dataclass
class GridNowhere(Regularizer):
    @hookimpl
    def nerfreg_occupancy(self):
        cells = torch.ones(4, 4, 4, dtype=torch.bool)
        return OccupancyGrid(cells, torch.full((3,), torch.nan), 1.0)


@dataclass
class SilentGrid(Regularizer):
    @hookimpl
    def nerfreg_occupancy(self):
        pass


def test_wrong_and_forgotten_grids(found):
    lines = found(GridNowhere, "fog", "steps")["contract"]
    assert any("nerfreg_occupancy: low: 3 of 3 values not finite" in line for line in lines)
    messages = found(SilentGrid, "fog", "steps", "run")
    silent = "nerfreg_occupancy returned None each time, which has no effect"
    assert messages == {"contract": [f"{silent}; return an OccupancyGrid"]}


@dataclass
class BadBuilding(Regularizer):
    @hookimpl
    def nerfreg_encoder(self, which):
        return nn.Linear(3, 4) if which == "positions" else None

    @hookimpl
    def nerfreg_module(self):
        return TrainedModule(nn.Linear(1, 1), lr_scale=-1.0)

    @hookimpl
    def nerfreg_prepare(self, photographs):
        return {"mean": photographs.images.mean((1, 2))}


def test_wrong_truth_values_encoders_modules_and_data(found):
    lines = found(NotTruthValues, "fog")["contract"]
    assert any("boolean" in line or "torch.bool" in line for line in lines)
    messages = found(BadBuilding, "photos_noise", "run")
    lines = "\n".join(line for part in messages.values() for line in part)
    assert "width" in lines
    assert "'mean'" in lines


@dataclass
class ThreeFaults(Regularizer):
    """In double precision, with global randomness, and a graph that is kept."""

    def __post_init__(self):
        self._kept = []

    @hookimpl
    def nerfreg_loss(self, rendering):
        self._kept.append(rendering)
        return {"suspect": (rendering.opacity.double() * np.random.rand()).mean()}


def test_three_faults_at_once(found):
    messages = found(ThreeFaults, "fog", "terms", "steps", "cost", "run")
    lines = "\n".join(line for part in messages.values() for line in part)
    assert "term 'suspect' is in float64" in lines
    assert "numpy's global generator" in lines
    assert "are kept alive after their step" in lines


@dataclass
class NeedsFiles(Regularizer):
    @hookimpl
    def nerfreg_prepare(self, photographs):
        from nerfreg.errors import NerfregError

        raise NerfregError("depth/0.png: no such file")

    @hookimpl
    def nerfreg_loss(self, rendering):
        return {"suspect": rendering.rays.data["suspect.rank"].mean()}


def test_what_needs_files_is_skipped(subject):
    report = check(subject(NeedsFiles), ALL_CASES, ("float32",), 48)
    assert report.failures == []
    assert report.skipped["value"] == "nerfreg_prepare: depth/0.png: no such file"
    assert {"run", "cost", "steps"} <= report.skipped.keys()
