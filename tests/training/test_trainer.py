"""Training steps on a small scene: they learn, they repeat, and a fused step is a plain step."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
import torch

from nerfreg.errors import NerfregError
from nerfreg.field.network import Network
from nerfreg.hooks import Rendering
from nerfreg.registry import Hooks
from nerfreg.scenes.scene import Photographs
from nerfreg.training.loss import color_error
from nerfreg.training.trainer import Trainer


def color_errors(trainer: Trainer, steps: int) -> list[float]:
    return [float(trainer.step()[0].value) for _ in range(steps)]


def test_the_error_falls(make: Callable[..., Trainer]) -> None:
    errors = color_errors(make(), 40)
    assert sum(errors[-5:]) < 0.7 * sum(errors[:5])


# In a scene as small as this, too little is known for some plugins.
@pytest.mark.filterwarnings("ignore::nerfreg.errors.NerfregWarning")
def test_every_preset_and_plugin_trains(make: Callable[..., Trainer]) -> None:
    # the whole of CombiNeRF, and the rest of the plugins together
    for reg in (
        "combinerf",
        "[entropy,adversarial,annealing,occlusion]",
        "[combinerf_plus,unseen_smoothness]",
    ):
        trainer = make(f"+reg={reg}")
        before = [p.detach().clone() for p in trainer.field.parameters()]
        for _ in range(6):
            terms = trainer.step()
        assert all(torch.isfinite(term.value) for term in terms)
        assert len({term.plugin for term in terms}) >= 4
        after = list(trainer.field.parameters())
        assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
        assert all(torch.isfinite(p).all() for p in after)


def test_the_worst_small_perturbation_lets_a_field_learn(make: Callable[..., Trainer]) -> None:
    fine = (
        "scene.size=48",
        "train.rays=256",
        "field.levels=16",
        "field.finest=1024",
        "field.log2_entries=15",
    )
    alone, perturbed = (
        color_errors(make(*fine, "train.steps=200", *reg), 200)[-20:]
        for reg in ((), ("+reg=adversarial",))
    )
    assert sum(perturbed) < 1.3 * sum(alone)


def test_the_same_seed_gives_the_same_weights(make: Callable[..., Trainer]) -> None:
    def weights(seed: int) -> torch.Tensor:
        trainer = make("+reg=combinerf", f"seed={seed}")
        for _ in range(200):
            trainer.step()
        return torch.cat([p.detach().flatten() for p in trainer.field.parameters()])

    assert torch.equal(weights(0), weights(0))
    assert not torch.equal(weights(0), weights(1))


def test_fused_and_plain_networks_train_alike(
    make: Callable[..., Trainer], monkeypatch: pytest.MonkeyPatch
) -> None:
    fused = color_errors(
        make("+reg=[lipschitz,distortion]", "reg.lipschitz.hidden_activation=gelu"), 10
    )
    monkeypatch.setattr(Network, "_affine", lambda self: None)
    plain = color_errors(
        make("+reg=[lipschitz,distortion]", "reg.lipschitz.hidden_activation=gelu"), 10
    )
    assert fused == pytest.approx(plain, rel=1e-3)


def test_numba_and_torch_grids_train_alike(make: Callable[..., Trainer]) -> None:
    numba, plain = color_errors(make(), 10), color_errors(make("field.backend=torch"), 10)
    assert numba == pytest.approx(plain, rel=1e-3)


def test_plugins_that_are_not_selected_change_nothing(make: Callable[..., Trainer]) -> None:
    alone = color_errors(make(), 5)
    silent = color_errors(make("+reg=distortion", "reg.distortion.weight=0"), 5)
    assert alone == silent


def test_the_learning_rate_decays_with_the_budget(make: Callable[..., Trainer]) -> None:
    trainer = make("train.steps=2", "optim.lr=0.01", "optim.decay=0.01")
    trainer.step()
    assert trainer.optimizer.param_groups[0]["lr"] == pytest.approx(0.01)
    trainer.step()
    assert trainer.optimizer.param_groups[0]["lr"] == pytest.approx(
        0.001
    )  # half of the budget: 0.01^(1/2)


def test_the_learning_rate_falls_by_the_steps_of_the_run(make: Callable[..., Trainer]) -> None:
    trainer = make("train.steps=3000", "optim.lr=0.01")
    trainer.budget.step = 1500
    trainer.step()
    # 3000 steps end at a quarter, so that half of them are at the square root of that.
    assert trainer.optimizer.param_groups[0]["lr"] == pytest.approx(0.005)


def test_the_color_error_by_hand(rendering: Callable[..., Rendering]) -> None:
    made = rendering(torch.ones(3))  # black
    made.rays.targets = torch.tensor([[1.0, 0.0, 0.5], [0.0, 0.0, 0.3]])  # the third ray has none
    # mean squares 1.25/3 and 0.09/3; their mean, and weighted by 0.5 and 1.5
    assert color_error(made).item() == pytest.approx(1.34 / 6)
    made.rays.target_weights = torch.tensor([0.5, 1.5])
    assert color_error(made).item() == pytest.approx((0.5 * 1.25 + 1.5 * 0.09) / 6)


def test_a_budget_spent_on_preparation_is_refused(
    make: Callable[..., Trainer], monkeypatch: pytest.MonkeyPatch
) -> None:
    def dawdle(hooks: Hooks, photographs: Photographs) -> None:
        time.sleep(0.02)

    monkeypatch.setattr(Hooks, "known_depth", dawdle)
    with pytest.raises(NerfregError, match=r"train.seconds=0.01: was spent before the first step"):
        make("train.steps=null", "train.seconds=0.01")
    trainer = make("train.steps=null", "train.seconds=10")
    assert trainer.budget.seconds >= 0.02 and trainer.budget.step == 0


def test_what_is_known_of_depth_comes_with_the_rays(make: Callable[..., Trainer]) -> None:
    trainer = make("+reg=stereo")
    known = trainer.batches.known_depth
    assert known is not None and known.shape == (*trainer.batches.photographs.images.shape[:3], 2)
    assert "stereo" in [term.name for term in trainer.step()]
