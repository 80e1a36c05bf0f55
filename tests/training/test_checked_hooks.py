"""`train.check=true`: wrong outputs of hooks are refused, right ones train as without it."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from nerfreg import Needs, NerfregError, Regularizer, Rendering, Samples, Step, hookimpl
from nerfreg.cli import main
from nerfreg.config.schema import Config
from nerfreg.hooks import Rays
from nerfreg.registry import Hooks
from nerfreg.scenes import load_scene
from nerfreg.training.checked_hooks import CheckedHooks
from nerfreg.training.trainer import Trainer

SMALL = [
    "scene.size=16",
    "scene.views=3",
    "scene.test_views=1",
    "field.levels=4",
    "field.finest=64",
    "sampler.coarse=8",
    "sampler.fine=8",
    "field.log2_entries=10",
    "train.rays=64",
    "train.steps=5",
    "train.quiet=true",
    "eval.count=1",
    "eval.lpips=false",
    "hydra.run.dir=run",
]


def steps(compose: Callable[..., Config], hooks: Hooks, count: int) -> Trainer:
    config = compose(*SMALL[:-1])
    scene = load_scene(config.scene)
    trainer = Trainer(
        scene, hooks, config.field, config.sampler, config.optim, config.train, config.seed
    )
    for _ in range(count):
        trainer.step()
    return trainer


@dataclass
class Editor(Regularizer):
    """Writes into what it is given to read."""

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Tensor]:
        with torch.no_grad():
            rendering.depth.clamp_(max=1.0)
        return {"editor": rendering.opacity.mean()}


@dataclass
class Backwards(Regularizer):
    @hookimpl(wrapper=True)
    def nerfreg_ray_bounds(self) -> Generator[None, Any, Any]:
        near, far = yield
        return far, near


@dataclass
class Halved(Regularizer):
    @hookimpl(wrapper=True)
    def nerfreg_ray_bounds(self) -> Generator[None, Any, Any]:
        near, far = yield
        return near, (near + far) / 2


@dataclass
class Lonely(Regularizer):
    @hookimpl
    def nerfreg_ray_bounds(self, rays: Rays) -> Any:
        return rays.near


@dataclass
class NearEditor(Regularizer):
    @hookimpl
    def nerfreg_ray_bounds(self, rays: Rays) -> Any:
        return rays.near.add_(0.01), rays.far


@dataclass
class Lost(Regularizer):
    """From step 2 on positions are not finite."""

    @hookimpl(wrapper=True)
    def nerfreg_encoder_input(self, step: Step) -> Generator[None, Any, Any]:
        samples = yield
        return replace(samples, positions=samples.positions / (step.index < 2))


@dataclass
class DirectionEditor(Regularizer):
    """The directions of samples are those of the rays, which others read too."""

    @hookimpl
    def nerfreg_encoder_input(self, samples: Samples) -> Samples:
        samples.directions.neg_()
        return samples


@dataclass
class Greedy(Regularizer):
    @hookimpl
    def nerfreg_needs(self) -> Needs:
        return Needs(patch_size=2, patch_fraction=2.0)


@dataclass
class Narrow(Regularizer):
    @hookimpl
    def nerfreg_layer(self, in_features: int, out_features: int) -> nn.Module:
        return nn.Linear(in_features, out_features - 1)


@dataclass
class Infinite(Regularizer):
    @hookimpl
    def nerfreg_loss(self, rendering: Rendering) -> dict[str, Tensor]:
        return {"one": rendering.opacity.mean(), "other": 1 / (rendering.opacity.mean() * 0)}


@pytest.mark.parametrize(
    "plugin, message",
    [
        (Editor(), "plugin it, nerfreg_loss at step 0: rendering.depth has been edited in place"),
        (Backwards(), "plugin it, nerfreg_ray_bounds at step 0: near > far on "),
        (
            Lonely(),
            "plugin it, nerfreg_ray_bounds at step 0: returned something else than (near, far)",
        ),
        (
            NearEditor(),
            "plugin it, nerfreg_ray_bounds at step 0: rays.near has been edited in place",
        ),
        (Lost(), "plugin it, nerfreg_encoder_input at step 2: positions: "),
        (
            DirectionEditor(),
            "plugin it, nerfreg_encoder_input at step 0: "
            "samples.directions has been edited in place",
        ),
        (
            Greedy(),
            "plugin it, nerfreg_needs at step 0: patch_fraction=2.0: must be between 0 and 1",
        ),
        (
            Narrow(),
            "plugin it, nerfreg_layer: layer 0 of the density network: "
            "output: has shape (2, 63), not (2, 64)",
        ),
        (Infinite(), "plugin it, nerfreg_loss at step 0: term 'other' is inf"),
    ],
)
def test_wrong_outputs_are_refused(
    compose: Callable[..., Config], plugin: Regularizer, message: str
) -> None:
    with pytest.raises(NerfregError) as error:
        steps(compose, CheckedHooks({"it": plugin}, every=1), 3)
    assert str(error.value).startswith(message)


def test_several_that_change_one_thing_are_all_named(compose: Callable[..., Config]) -> None:
    hooks = CheckedHooks(
        {"back": Backwards(), "half": Halved(), "innocent": Infinite(weight=0.0)}, every=1
    )
    with pytest.raises(
        NerfregError, match=r"^plugins back, half, nerfreg_ray_bounds at step 0: near > far"
    ):
        steps(compose, hooks, 1)


def test_only_every_nth_step_is_looked_at(compose: Callable[..., Config]) -> None:
    # positions break in step 2; steps 0 and 3 are looked at, and step 2 is left out by the guard
    with pytest.raises(NerfregError, match="at step 3"):
        steps(compose, CheckedHooks({"lost": Lost()}, every=3), 4)


def test_right_plugins_train_as_without_it(compose: Callable[..., Config]) -> None:
    names = "combinerf,entropy,adversarial,annealing,occlusion"

    def weights(kind: Callable[..., Hooks]) -> list[Tensor]:
        trainer = steps(compose, kind(compose(f"+reg=[{names}]").reg), 5)
        return [p.detach() for p in trainer.field.parameters()]

    plain, checked = weights(Hooks), weights(lambda plugins: CheckedHooks(plugins, every=1))
    assert all(torch.equal(a, b) for a, b in zip(plain, checked, strict=True))


def test_it_is_chosen_by_a_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from nerfreg_plugins.annealing import Annealing

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Annealing, "nerfreg_ray_bounds", Backwards.nerfreg_ray_bounds)
    words = ["train", "+reg=annealing", *SMALL]
    assert main([*words, "train.check=true"]) == 4
    expected = "plugin annealing, nerfreg_ray_bounds at step 0: near > far on "
    assert capsys.readouterr().err.startswith(f"nerfreg: error: {expected}")
    assert main([*words, "train.check=true", "train.check_every=0"]) == 2
    assert "train.check_every=0: must be at least 1" in capsys.readouterr().err
