from __future__ import annotations

import pytest
import torch

from nerfreg.checks.cases import CASES, LARGE
from nerfreg.checks.inputs import DTYPES, Inputs, cast
from nerfreg.rendering.compositing import integrate

BY_NAME = {case.name: case for case in CASES}


def tau(inputs: Inputs) -> torch.Tensor:
    return inputs.density * inputs.t_edges.diff()


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
@pytest.mark.parametrize("samples", LARGE)
def test_is_a_valid_batch_and_always_the_same(case, samples):
    inputs, again = case.build(samples), case.build(samples)
    rays, count = inputs.rays, len(inputs.rays)
    assert torch.equal(inputs.density, again.density)
    assert inputs.density.shape == (count, samples)
    assert inputs.t_edges.shape == (count, samples + 1)
    assert (inputs.t_edges.diff() >= 0).all()
    assert (inputs.density >= 0).all()
    torch.testing.assert_close(rays.directions.norm(dim=1), torch.ones(count).double())
    assert torch.equal(rays.near, inputs.t_edges[:, 0])
    assert torch.equal(rays.far, inputs.t_edges[:, -1])
    side = rays.patches.shape[-1]
    rows, columns = rays.neighbors.div(side, rounding_mode="floor"), rays.neighbors % side
    assert ((rows.diff() + columns.diff()) == 1).all(), "neighbours are one pixel apart"
    # neighbours share their t
    assert torch.equal(inputs.t_edges[rays.neighbors[:, 0]], inputs.t_edges[rays.neighbors[:, 1]])
    assert rays.unseen.min() >= len(rays.targets)
    assert torch.equal(rays.unseen_patches.flatten(), rays.unseen)


@pytest.mark.parametrize(
    ("name", "total"),
    [("thickness_1e-12", 1e-12), ("thickness_1e6", 1e6), ("thickness_1e30", 1e30)],
)
def test_thickness(name, total):
    """Each ray has the named thickness times a factor of its own, from 0.5 to 1.5."""
    factors = tau(BY_NAME[name].build(48)).sum(1) / total
    assert factors.min() >= 0.5
    assert factors.max() <= 1.5
    assert len(factors.unique()) == len(factors)


def test_uniform_weights_are_equal():
    inputs = BY_NAME["uniform"].build(48)
    weights = integrate(inputs.density, inputs.t_edges).weights
    torch.testing.assert_close(weights, torch.full_like(weights, 1 / 49))


def test_one_hot_weights():
    inputs = BY_NAME["one_hot"].build(48)
    weights = integrate(inputs.density, inputs.t_edges).weights
    assert set(weights.unique().tolist()) == {0.0, 1.0}
    assert (weights.sum(1) == 1).all()
    assert len(weights.argmax(1).unique()) > 1


def test_weights_underflow_in_float32_but_not_in_float64():
    inputs = BY_NAME["underflow"].build(48)
    behind = int(0.6 * 47)
    double = integrate(inputs.density, inputs.t_edges).weights[:, behind]
    single = cast(inputs, torch.float32)
    assert (double > 0).all()
    assert (integrate(single.density, single.t_edges).weights[:, behind] == 0).all()


def test_neighbours_that_disagree_have_no_interval_in_common():
    inputs = BY_NAME["disagreement"].build(48)
    ray, neighbor = (tau(inputs)[inputs.rays.neighbors[:, i]] > 0 for i in range(2))
    assert not (ray & neighbor).any()
    assert ray.any(1).all()


@pytest.mark.parametrize(("name", "visible"), [("just_visible", True), ("just_empty", False)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_both_sides_of_the_smallest_opacity(name, visible, dtype):
    inputs = cast(BY_NAME[name].build(48), dtype)
    opacity = integrate(inputs.density, inputs.t_edges).opacity
    assert ((opacity >= 1e-4) == visible).all()
    assert ((opacity - 1e-4).abs() < 2e-7).all()


def test_intervals():
    assert BY_NAME["sliver"].build(48).t_edges[0, :2].tolist() == [0.0, 1e-9]
    assert (BY_NAME["zero_width"].build(48).t_edges.diff() == 0).float().mean() == 0.5
    assert (BY_NAME["near_is_far"].build(48).t_edges == 2).all()
    packed = BY_NAME["packed"].build(48).t_edges
    assert (packed.min(), packed.max()) == (10000, 10001)


def test_patches_with_missing_depth():
    inputs = BY_NAME["missing_depth"].build(48)
    empty = (tau(inputs).sum(1) == 0)[inputs.rays.patches]
    assert empty.any()
    assert not empty.all()


def test_precisions_that_cannot_express_a_case_are_left_out():
    """float16 ends at 65504, below the distances of a scene of 1e6."""
    tried = {
        name: [spot.dtype for spot, _ in BY_NAME[name].points([*DTYPES], 48)] for name in BY_NAME
    }
    assert tried["fog"] == [*DTYPES]
    assert tried["huge_scale"] == ["float32", "float64", "bfloat16"]


def test_half_precision_is_tried_at_one_size():
    points = [(spot.dtype, spot.samples) for spot, _ in BY_NAME["ramp"].points([*DTYPES], None)]
    assert points == [
        *[(dtype, samples) for dtype in ("float32", "float64") for samples in LARGE],
        ("bfloat16", 48),
    ]
