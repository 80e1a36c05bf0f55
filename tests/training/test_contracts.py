"""What is wrong with a hook's output is said in one line; what is right, in none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from nerfreg.field.layers import Linear
from nerfreg.hooks import Needs, Rays, Rendering, Samples
from nerfreg.training.contracts import (
    Untouched,
    wrong_bounds,
    wrong_known_depth,
    wrong_layer,
    wrong_needs,
    wrong_samples,
    wrong_terms,
)


@pytest.fixture
def samples() -> Samples:
    """Two rays with three samples each."""
    return Samples(
        torch.zeros(2, 3, 3), torch.eye(3)[:2], torch.ones(2, 3), density_width=32, color_width=16
    )


@pytest.mark.parametrize(
    "needs", [None, Needs(), Needs(4, 1.0, "extra", 0.5), Needs(patch_size=0, neighbors="patch")]
)
def test_needs_that_can_be_met(needs: Needs | None) -> None:
    assert wrong_needs(needs) == []


@pytest.mark.parametrize(
    "needs, wrong",
    [
        ({"patch_size": 4}, "returned of type dict, not a Needs"),
        (Needs(patch_size=-1), "patch_size=-1: must be an integer, at least 0"),
        (Needs(patch_fraction=1.5), "patch_fraction=1.5: must be between 0 and 1"),
        (Needs(patch_fraction=float("nan")), "patch_fraction=nan: must be between 0 and 1"),
        (Needs(unseen_rays=float("inf")), "unseen_rays=inf: must be at least 0 and below 1"),
        (Needs(unseen_patches=1.0), "unseen_patches=1.0: must be at least 0 and below 1"),
        (Needs(neighbors="diagonal"), "neighbors='diagonal': must be one of none, patch, extra"),
    ],
)
def test_needs_that_cannot(needs: object, wrong: str) -> None:
    assert wrong_needs(needs) == [wrong]


def test_each_mistake_has_its_line() -> None:
    assert len(wrong_needs(Needs(-1, -1.0, "", -1.0))) == 4


def test_bounds_may_meet(rays: Rays) -> None:
    assert wrong_bounds(rays.near, rays.far, rays) == []
    assert wrong_bounds(rays.far, rays.far, rays) == []


@pytest.mark.parametrize(
    "near, far, wrong",
    [
        ([1.0, 4.0], [3.0, 3.0], ["near > far on 1 of 2 rays, the first ray 1: near 4, far 3"]),
        ([1.0], [3.0, 3.0], ["near: has shape (1,), not (2,)"]),
        ([1.0, 1.0], [3.0, float("inf")], ["far: 1 of 2 values not finite, the first at [1]: inf"]),
        (
            [float("nan"), 1.0],
            [[3.0, 3.0]],
            [
                "near: 1 of 2 values not finite, the first at [0]: nan",
                "far: has shape (1, 2), not (2,)",
            ],
        ),
    ],
)
def test_bounds_that_cannot_be_sampled(near: list, far: list, wrong: list[str], rays: Rays) -> None:
    assert wrong_bounds(torch.tensor(near), torch.tensor(far), rays) == wrong


def test_bounds_of_another_kind(rays: Rays) -> None:
    assert wrong_bounds(rays.near.double(), 3.0, rays) == [
        "near: has dtype torch.float64, not torch.float32",
        "far: is of type float, not a tensor",
    ]


def test_samples_may_change_within_their_shapes(samples: Samples) -> None:
    assert wrong_samples(samples, samples) == []
    per_sample = torch.zeros(2, 3, 3)
    assert (
        wrong_samples(samples, replace(samples, directions=per_sample, density_features=0.0)) == []
    )
    assert (
        wrong_samples(samples, replace(samples, positions=per_sample + 1, color_features=16.0))
        == []
    )


@pytest.mark.parametrize(
    "name, value, wrong",
    [
        ("positions", torch.zeros(2, 4, 3), "positions: has shape (2, 4, 3), not (2, 3, 3)"),
        ("positions", None, "positions: is None, not a tensor"),
        (
            "t",
            torch.full((2, 3), torch.nan),
            "t: 6 of 6 values not finite, the first at [0, 0]: nan",
        ),
        ("directions", torch.zeros(2, 2), "directions: has shape (2, 2), not (2, 3)"),
        ("directions", torch.zeros(2, 4, 3), "directions: has shape (2, 4, 3), not (2, 3, 3)"),
        ("density_features", 32.5, "density_features=32.5: must be None, or between 0 and 32"),
        ("color_features", -1.0, "color_features=-1.0: must be None, or between 0 and 16"),
        ("color_features", float("nan"), "color_features=nan: must be None, or between 0 and 16"),
        ("density_width", 16, "density_width=16: is the core's, 32; leave it"),
    ],
)
def test_samples_that_no_field_takes(
    samples: Samples, name: str, value: object, wrong: str
) -> None:
    after = replace(samples)
    setattr(after, name, value)  # the constructor would refuse some of these here
    assert wrong_samples(samples, after) == [wrong]


def test_samples_must_come_back(samples: Samples) -> None:
    assert wrong_samples(samples, None) == [
        "returned None, not Samples; return `samples` to leave them as they are"
    ]


def test_terms() -> None:
    def term(value: Tensor) -> list[str]:
        return wrong_terms({"kl": value})

    assert wrong_terms({}) == term(torch.tensor(-3.0)) == []
    assert term(torch.tensor(torch.inf)) == ["term 'kl' is inf"]
    assert term(torch.zeros(2)) == ["term 'kl' has shape (2,), not that of a scalar"]


class Broken(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        raise ValueError("no such thing\nand more of it")


class Infinite(nn.Module):
    """1 / 0 on the second of the two points, a row of ones."""

    def forward(self, x: Tensor) -> Tensor:
        return 1 / (1 - x)


def test_layers() -> None:
    assert wrong_layer(Linear(3, 5, "relu"), 3, 5) == []
    assert wrong_layer(nn.Linear(3, 5), 3, 5) == []
    assert wrong_layer(None, 3, 5) == ["returned None, not a torch module"]
    assert wrong_layer(Broken(), 3, 5) == ["fails on (points, 3): ValueError: no such thing"]
    assert wrong_layer(Infinite(), 3, 3) == [
        "output: 3 of 6 values not finite, the first at [1, 0]: inf"
    ]
    assert wrong_layer(nn.Linear(3, 4), 3, 5) == ["output: has shape (2, 4), not (2, 5)"]
    spoiled = Linear(3, 5)
    with torch.no_grad():
        spoiled.weight[1, 2] = torch.nan
    lines = wrong_layer(spoiled, 3, 5)
    assert lines[0] == "weight: 1 of 15 values not finite, the first at [1, 2]: nan"
    assert lines[-1] == "effective weight: 1 of 15 values not finite, the first at [1, 2]: nan"


def test_a_layer_that_draws_numbers_is_tried_without_drawing_any() -> None:
    before = torch.get_rng_state()
    assert wrong_layer(nn.Dropout(), 3, 3) == []
    assert torch.equal(before, torch.get_rng_state())


@pytest.fixture
def untouched(rendering: Callable[..., Rendering]) -> tuple[Rendering, Untouched]:
    made = rendering(torch.tensor([0.25, 0.5]))
    return made, Untouched(made)


def test_reading_is_no_edit(untouched: tuple[Rendering, Untouched]) -> None:
    rendering, watch = untouched
    rendering.log_weights.exp().sum()  # -inf where tau is 0
    rendering.weights.clone().mul_(2)
    assert watch.edits() == []


def edit_a_view(rendering: Rendering) -> None:
    rendering.depth[1] = 0


def edit_detached(rendering: Rendering) -> None:
    rendering.depth.detach().add_(1)


def edit_data(rendering: Rendering) -> None:
    rendering.depth.data.add_(1)


def edit_numpy(rendering: Rendering) -> None:
    rendering.depth.numpy()[0] = 7


def edit_to_the_same(rendering: Rendering) -> None:
    rendering.depth.mul_(1)  # autograd counts it, and refuses the backward pass


@pytest.mark.parametrize(
    "edit", [edit_a_view, edit_detached, edit_data, edit_numpy, edit_to_the_same]
)
def test_edits_in_place(
    edit: Callable[[Rendering], None], untouched: tuple[Rendering, Untouched]
) -> None:
    rendering, watch = untouched
    rendering.depth = rendering.depth  # the same tensor is no replacement
    edit(rendering)
    # conftest's rendering stores one tensor of zeros as its depth and as near of its rays
    assert set(watch.edits()) == {
        "depth has been edited in place",
        "rays.near has been edited in place",
    }


def test_replaced_lost_and_computed_tensors(untouched: tuple[Rendering, Untouched]) -> None:
    rendering, watch = untouched
    rendering.rgb = rendering.rgb + 1
    rendering.alphas.sub_(1)
    rendering.rays.background = torch.ones(2, 3)
    assert sorted(watch.edits()) == [
        "alphas has been edited in place",
        "rays.background has been added",
        "rgb has been replaced",
    ]


def test_nan_is_like_nan() -> None:
    samples = Samples(torch.full((1, 1, 3), torch.nan), torch.zeros(1, 3), torch.zeros(1, 1))
    watch = Untouched(samples)
    assert watch.edits() == []
    samples.positions.data[0, 0, 0] = 0
    assert watch.edits() == ["positions has been edited in place"]


def test_half_known_intervals_are_wrong():
    known = torch.tensor([[1.0, 2.0], [float("nan")] * 2, [float("nan"), 2.0]]).view(1, 1, 3, 2)
    assert wrong_known_depth(known) == ["one end is NaN and the other is not, in 1 pixels"]
