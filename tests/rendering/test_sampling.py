"""Where samples fall."""

from __future__ import annotations

import pytest
import torch

from nerfreg.rendering.sampling import edges_between, equal_shares, importance, merge, stratified


def test_strata_without_a_generator_give_their_midpoints() -> None:
    t = stratified(torch.tensor([1.0]), torch.tensor([5.0]), 4)
    torch.testing.assert_close(t, torch.tensor([[1.5, 2.5, 3.5, 4.5]]))


def test_disparity_is_even_in_the_reciprocal() -> None:
    t = stratified(torch.tensor([1.0]), torch.tensor([4.0]), 2, "disparity")
    # 1/t runs from 1 to 1/4; the quarter points are 13/16 and 7/16
    torch.testing.assert_close(t, torch.tensor([[16 / 13, 16 / 7]]))


def test_disparity_of_rays_that_begin_at_the_camera() -> None:
    t = stratified(torch.zeros(1), torch.tensor([4.0]), 4, "disparity")
    assert torch.isfinite(t).all() and (t.diff() > 0).all() and t.min() > 0 and t.max() < 4


@pytest.mark.parametrize("spacing", ["linear", "disparity"])
def test_each_stratum_gets_one_sample(spacing: str) -> None:
    generator = torch.Generator().manual_seed(0)
    near, far = torch.full((100,), 1.0), torch.full((100,), 3.0)
    t = stratified(near, far, 8, spacing, generator)
    u = (t - 1) / 2 if spacing == "linear" else (1 - 1 / t) / (1 - 1 / 3)
    assert torch.equal((u * 8).floor().long(), torch.arange(8).expand(100, 8))


def test_edges_lie_halfway_and_end_at_the_bounds() -> None:
    edges = edges_between(torch.tensor([[1.0, 2.0, 4.0]]), torch.tensor([0.5]), torch.tensor([9.0]))
    assert edges.tolist() == [[0.5, 1.5, 3.0, 9.0]]


def test_importance_samples_follow_the_weights() -> None:
    # Intervals [0,1], [1,2], [2,4] with weights 1, 3, 0: a quarter of the samples in the first, the
    # rest in the second; the floor of 1e-5 is too small to be seen among 8 samples.
    edges, weights = torch.tensor([[0.0, 1.0, 2.0, 4.0]]), torch.tensor([[1.0, 3.0, 0.0]])
    t = importance(edges, weights, 8)
    # u = 1/16, 3/16, 5/16, ...: t = 4u in the first, 1 + (u - 1/4) * 4/3 in the second
    u = (torch.arange(8) + 0.5) / 8
    expected = torch.where(u < 0.25, 4 * u, 1 + (u - 0.25) * 4 / 3)
    torch.testing.assert_close(t[0], expected, rtol=0, atol=1e-4)


def test_importance_of_nothing_is_even() -> None:
    t = importance(torch.linspace(0, 1, 5)[None], torch.zeros(1, 4), 4)
    torch.testing.assert_close(t, torch.tensor([[0.125, 0.375, 0.625, 0.875]]))


@pytest.mark.parametrize(
    "weights", [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [1e30, 1e-30, 0.0, 1e30]]
)
def test_importance_of_walls_stays_ascending_and_inside(weights: list[float]) -> None:
    generator = torch.Generator().manual_seed(0)
    edges = torch.tensor([[2.0, 2.0, 3.0, 3.0 + 1e-6, 10.0]])
    t = importance(edges, torch.tensor([weights]), 64, generator)
    assert torch.isfinite(t).all() and (t.diff() >= 0).all() and t.min() >= 2 and t.max() <= 10


def test_merge_tells_where_each_came_from() -> None:
    t, order = merge(torch.tensor([[1.0, 3.0]]), torch.tensor([[2.0, 3.0]]))
    assert t.tolist() == [[1.0, 2.0, 3.0, 3.0]]
    assert order.tolist() == [[0, 2, 1, 3]]


def test_equal_shares_run_from_end_to_end() -> None:
    # Weights 1, 3, 0 in [0,1], [1,2], [2,4]: quarters end at 1, 4/3, 5/3 and, all weight being
    # spent, 4.
    edges, weights = torch.tensor([[0.0, 1.0, 2.0, 4.0]]), torch.tensor([[1.0, 3.0, 0.0]])
    cuts, begins = equal_shares(edges, weights, 4)
    torch.testing.assert_close(
        cuts, torch.tensor([[0.0, 1.0, 4 / 3, 5 / 3, 4.0]]), rtol=0, atol=1e-4
    )
    # the first cut after 1 lies behind it only by what the floor adds
    assert begins[0].tolist() in ([0, 1, 1, 1], [0, 0, 1, 1])


def test_samples_keep_the_precision_of_the_rays() -> None:
    near, far = torch.ones(2, 3, dtype=torch.float64)
    assert stratified(near, far + 1, 4).dtype == torch.float64
    edges = torch.linspace(0, 1, 5, dtype=torch.float64)[None]
    assert importance(edges, torch.ones(1, 4, dtype=torch.float64), 3).dtype == torch.float64
