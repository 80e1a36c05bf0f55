from __future__ import annotations

from dataclasses import dataclass
from statistics import mean

import pytest
import torch
from torch import Tensor

from nerfreg import NerfregError, Regularizer, Rendering, hookimpl
from nerfreg.testing import ShortRun, run_steps

STEPS = 30


@dataclass
class FullOpacity(Regularizer):
    """Every ray hits something."""

    weight: float = 10.0

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Tensor]:
        return {"missing": (1 - rendering.opacity).square().mean()}


@pytest.fixture(scope="module")
def regularized() -> ShortRun:
    return run_steps(FullOpacity(), STEPS)


@pytest.fixture(scope="module")
def vanilla() -> ShortRun:
    return run_steps(None, STEPS)


def test_terms_of_each_step(regularized: ShortRun, vanilla: ShortRun) -> None:
    assert len(regularized.terms) == len(vanilla.terms) == STEPS
    assert regularized.terms[0].keys() == {"color", "full_opacity.missing"}
    assert vanilla.terms[0].keys() == {"color"}


def test_plugin_does_what_it_is_for(regularized: ShortRun) -> None:
    missing = regularized.values("full_opacity.missing")
    assert mean(missing[-5:]) < 0.1 * mean(missing[:5])


def test_field_is_trained_and_scored(vanilla: ShortRun, regularized: ShortRun) -> None:
    assert mean(vanilla.values("color")[-5:]) < 0.5 * mean(vanilla.values("color")[:5])
    # Opaque everywhere is wrong: the background of the procedural scene is empty.
    assert vanilla.scores.psnr > regularized.scores.psnr
    assert vanilla.scores.views[0].view == vanilla.scene.test[0]


def test_same_seed_same_weights(vanilla: ShortRun) -> None:
    again, other = run_steps(None, STEPS), run_steps(None, 2, seed=1)
    weights = [dict(run.field.state_dict()) for run in (vanilla, again, other)]
    name = next(iter(weights[0]))
    assert torch.equal(weights[0][name], weights[1][name])
    assert not torch.equal(weights[0][name], weights[2][name])


def test_several_by_name_and_functions() -> None:
    several = {"first": FullOpacity(weight=1.0), "second": lambda opacity: opacity.mean()}
    run = run_steps(several, 2)
    assert run.terms[0].keys() == {"color", "first.missing", "second.loss"}


def test_unknown_term(vanilla: ShortRun) -> None:
    with pytest.raises(NerfregError, match=r"^no step has a term 'colour'; there are color$"):
        vanilla.values("colour")


def test_wrong_answers_name_the_hook() -> None:
    with pytest.raises(NerfregError, match=r"plugin loss, nerfreg_loss at step 0: term 'loss' has"):
        run_steps(lambda opacity: opacity, 2)


def test_a_step_that_is_not_finite_fails() -> None:
    with pytest.raises(AssertionError, match=r"^expected a finite step, found step 0 left out"):
        # The root of exactly 0 is 0, and its slope infinite.
        run_steps(lambda opacity: (opacity - opacity.detach()).sqrt().mean(), 2)
    with pytest.raises(NerfregError, match=r"nerfreg_loss at step 0: term 'loss' is nan$"):
        run_steps(lambda opacity: opacity.mean() * torch.nan, 2)
